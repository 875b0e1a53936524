"""A film of a drop whose name is no formula and has letters that no font draws."""

import io
import warnings

import numpy as np
from PIL import Image

from sysid.gear.model import PARAMETERS
from sysid.report.drop_replay import DropReplay
from sysid.report.snapshots import film_bytes


def test_a_film_warns_of_no_letter_and_reads_no_formula(caplog):
    time = np.arange(0.0, 0.03, 1e-3)
    still, zero = np.zeros((len(time), 3)), np.zeros((len(time), 2))
    drop = DropReplay(
        "$\\frac{1$ 落", "fit", 0.3, time, body=still, feet=np.zeros((len(time), 2, 2)), normal_force=zero,
        friction_force=zero, measured=still, contacts=(), values=PARAMETERS.nominal, slip_speed=zero,
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        film = Image.open(io.BytesIO(film_bytes(drop, "gif")))
    assert film.n_frames == 6
    assert not caplog.records
