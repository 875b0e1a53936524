"""What a motor fit makes of doubtful input, and says of it: a bad point, volts in some logs, half a scale."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.campaign import read_campaign
from sysid.pipelines.bench_curves import NoLoadTie
from sysid.pipelines.motor_bench import prepare_bench
from sysid.synthetic.motor import TrialPlan, synthesize_motor

# R/(k_m k_v) of Table I [rad/s per N·m], its drag curve, and a no-load line.
DROP, DRAG, SLOPE, INTERCEPT = 0.299 / 0.00995**2, 1.65e-7, 973.0, 20.0


def _tie(bad: int | None, miss: float) -> NoLoadTie:
    """Return a tie of 12 loaded points with 0.5 rad/s of noise, one of them read `miss` times too fast."""
    u = np.linspace(0.2, 1.0, 12)
    omega_0 = SLOPE * u + INTERCEPT
    # Ω + DROP DRAG Ω² = Ω_0
    speed = (np.sqrt(1.0 + 4.0 * DROP * DRAG * omega_0) - 1.0) / (2.0 * DROP * DRAG)
    speed += np.random.default_rng(4).normal(0.0, 0.5, u.size)
    if bad is not None:
        speed[bad] *= miss
    return NoLoadTie(np.column_stack([u, np.ones(12)]), np.column_stack([speed, DRAG * speed**2]))


@pytest.mark.parametrize("bad", [None, 0, 6, 11])
@pytest.mark.parametrize("miss", [0.5, 12.0 / 14.0])
def test_one_bad_point_does_not_bend_the_no_load_line(bad: int | None, miss: float) -> None:
    tie = _tie(bad, miss)
    fit = tie.fit("forward", DROP, 0.0)
    # 12 points of 0.5 rad/s, lifted by 1 + 2 DROP DRAG Ω < 1.6: 0.8 rad/s over an rms distance of 0.25 in u
    # fixes the slope to 0.9 rad/s. A bad point pulls at most like one of the others at a few sigma.
    assert fit.coefficients[0] == pytest.approx(SLOPE, abs=5.0)
    assert fit.coefficients[1] == pytest.approx(INTERCEPT, abs=4.0)
    assert fit.outliers == (0 if bad is None else 1)
    assert fit.r_squared > 0.999
    # About the 0.9 rad/s of above, more where an end point is lost: it holds most of the slope.
    assert 0.4 < fit.standard_errors[0] < 3.0


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One short forward trial, its static logs at 11.1 V and no words on V_ref."""
    trials = (TrialPlan("forward-1", "forward", "fit", 0.25, (0.62, 0.35, 0.80), 0.45, "csv"),)
    path = synthesize_motor(tmp_path_factory.mktemp("doubts") / "motor", seed=3, trials=trials) / "campaign.toml"
    text = re.sub(r"^reference_voltage = .*\n", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    path.write_text(text, encoding="utf-8")
    return path


def _changed(path: Path, name: str, *pairs: tuple[str, str]) -> Path:
    text = path.read_text(encoding="utf-8")
    for pattern, new in pairs:
        text, count = re.subn(pattern, new, text, flags=re.MULTILINE)
        assert count, pattern
    other = path.with_name(name)
    other.write_text(text, encoding="utf-8")
    return other


def _bench(path: Path):
    return prepare_bench(read_campaign(path, "motor"), path)
