"""The slow twin of the compiled NRMSE."""

import numpy as np

from sysid.fit.nrmse import spread


def nrmse(simulated, measured, valid=None, denominator="std"):
    """Return the NRMSE of one channel (n,) of one trial over its valid samples."""
    simulated, measured = np.asarray(simulated, dtype=float), np.asarray(measured, dtype=float)
    mask = np.ones(measured.shape, bool) if valid is None else np.asarray(valid, dtype=bool)
    return float(np.sqrt(np.mean((simulated - measured)[mask] ** 2)) / spread(measured, mask, denominator))
