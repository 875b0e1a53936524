"""sysid: physical parameters of multirotor motors and landing gears from the logs of a lab.

    import sysid
    fit = sysid.fit_motor("data_samples/motor")
    fit.table

`sysid.api` documents what is offered.
"""

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid.api import Campaign as Campaign
    from sysid.api import Fit as Fit
    from sysid.api import Judgement as Judgement
    from sysid.api import compare as compare
    from sysid.api import cross_validate as cross_validate
    from sysid.api import explain as explain
    from sysid.api import fit_campaign as fit_campaign
    from sysid.api import fit_gear as fit_gear
    from sysid.api import fit_motor as fit_motor
    from sysid.api import inspect as inspect
    from sysid.api import load_fit as load_fit
    from sysid.api import load_log as load_log
    from sysid.api import validate as validate
    from sysid.api_landing import design_study as design_study
    from sysid.api_landing import impulse_map as impulse_map
    from sysid.api_landing import landing_map as landing_map
    from sysid.api_landing import numbers_for as numbers_for
    from sysid.api_landing import simulate_drop as simulate_drop
    from sysid.api_landing import simulate_landing as simulate_landing
    from sysid.api_landing import static_limits as static_limits
    from sysid.api_model import Model as Model
    from sysid.api_model import model as model
    from sysid.errors import SysidError as SysidError
    from sysid.export import load_parameter_sets as load_parameter_sets
    from sysid.parameter_sets import ParameterSets as ParameterSets

# A fit's matrices are small: several threads of BLAS wait for one another, take up to twice the processor
# time, and make the last bits depend on the number of cores.
_THREADS_OF_BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
if not any(name in os.environ for name in (*_THREADS_OF_BLAS, "OMP_NUM_THREADS")):
    if "numpy" in sys.modules:
        # A library that is loaded reads no environment any more.
        from threadpoolctl import threadpool_limits

        threadpool_limits(1, "blas")
    os.environ.update(dict.fromkeys(_THREADS_OF_BLAS, "1"))

__version__ = "0.1.0"
# Imported on first use: `import sysid` stays light.
_HOMES = {
    "sysid.api": (
        "Campaign", "Fit", "Judgement", "compare", "cross_validate", "explain", "fit_campaign",
        "fit_gear", "fit_motor", "inspect", "load_fit", "load_log", "validate",
    ),
    "sysid.api_landing": (
        "design_study", "impulse_map", "landing_map", "numbers_for", "simulate_drop", "simulate_landing",
        "static_limits",
    ),
    "sysid.api_model": ("Model", "model"),
    "sysid.errors": ("SysidError",),
    "sysid.export": ("load_parameter_sets",),
    "sysid.parameter_sets": ("ParameterSets",),
}  # fmt: skip
__all__ = sorted(name for names in _HOMES.values() for name in names)


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(home), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
