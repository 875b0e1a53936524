"""Static curves: known coefficients back from noisy points with outliers, real logs, refusals."""

import numpy as np
import pytest

from fakes import places
from sysid.errors import FitError
from sysid.loaders import load
from sysid.motor.static_curves import NoLoadTie, fit_no_load_line, fit_speed_curve

DATA = places.DATA / "rcbenchmark"
# R/(k_m k_v) of Table I [rad/s per N·m], its drag curve, and a no-load line.
DROP, DRAG, SLOPE, INTERCEPT = 0.299 / 0.00995**2, 1.65e-7, 973.0, 20.0


def _points(count: int = 60, outliers: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    speed = np.linspace(80.0, 750.0, count)
    thrust = 1.2e-5 * speed**2 + 4e-4 * speed + rng.normal(0.0, 0.02, count)
    thrust[rng.choice(count, outliers, replace=False)] += 2.0
    return speed, thrust


@pytest.mark.parametrize("outliers", [0, 9])
def test_known_curve_comes_back_whatever_the_outliers(outliers: int) -> None:
    fit = fit_speed_curve("thrust", "forward", *_points(outliers=outliers))
    assert fit.outliers == outliers
    for found, error, truth in zip(fit.coefficients, fit.standard_errors, (1.2e-5, 4e-4), strict=True):
        # 15 % of points 100 σ off pull a soft-L1 line by under 2 of its standard errors; 3 more for the draw.
        assert abs(found - truth) < 5.0 * error
    assert fit.r_squared > 0.999
    assert fit.points == 60


@pytest.mark.parametrize("outliers", [0, 3])
def test_standard_error_is_the_scatter_of_repeated_fits(outliers: int) -> None:
    rng = np.random.default_rng(5)
    speed = np.linspace(80.0, 750.0, 40)
    fits = []
    for _ in range(200):
        torque = 1.65e-7 * speed**2 + rng.normal(0.0, 1e-3, 40)
        # 100 σ off, either way: a misread point, which has no say in what the others scatter.
        torque[rng.choice(40, outliers, replace=False)] += 0.1 * rng.choice([-1.0, 1.0], outliers)
        fits.append(fit_speed_curve("torque", "forward", speed, torque))
    scatter = np.std([fit.coefficients[0] for fit in fits])
    stated = np.median([fit.standard_errors[0] for fit in fits])
    # 200 draws fix a standard deviation to 5 %; soft-L1 weights of normal noise understate it a little, and
    # three outliers of 40 take their points away.
    assert stated == pytest.approx(scatter, rel=0.25)


def test_each_direction_takes_its_own_points() -> None:
    speed = np.concatenate([np.linspace(-600.0, -100.0, 20), np.linspace(100.0, 700.0, 20)])
    thrust = np.where(speed > 0, 1.2e-5, 0.62e-5) * speed * np.abs(speed)
    for direction, truth in (("forward", 1.2e-5), ("reverse", 0.62e-5)):
        fit = fit_speed_curve("thrust", direction, speed, thrust)
        assert fit.coefficients[0] == pytest.approx(truth, rel=1e-9)  # noiseless: rounding
        assert fit.parameters == {
            f"thrust_quadratic_{direction}": fit.coefficients[0],
            f"thrust_linear_{direction}": fit.coefficients[1],
        }


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_load_line_from_loaded_points(sign: float) -> None:
    u = sign * np.linspace(0.2, 1.0, 9)
    ratio = np.linspace(1.0, 0.9, 9)
    omega_0 = (1000.0 * u + sign * 25.0) * ratio
    # Loaded speed by bisection of the equilibrium, an independent route.
    low, high = np.zeros(9), np.abs(omega_0)
    for _ in range(80):
        middle = 0.5 * (low + high)
        too_fast = middle + 3000.0 * 1.65e-7 * middle**2 > np.abs(omega_0)
        low, high = np.where(too_fast, low, middle), np.where(too_fast, middle, high)
    speed = sign * low
    direction = "forward" if sign > 0 else "reverse"
    drag = 1.65e-7 * speed * np.abs(speed)
    tie = NoLoadTie(np.column_stack([u, np.sign(u)]) * ratio[:, None], np.column_stack([speed, drag]))
    bare = fit_no_load_line(direction, u, omega_0, supply_ratio=ratio)
    assert bare.coefficients == pytest.approx((1000.0, 25.0), rel=1e-9)  # noiseless: rounding
    fit = tie.fit(direction, 3000.0, 0.0)  # R/(k_m k_v) of 0.3 Ω and 0.01 N·m/A
    assert fit.coefficients == pytest.approx((1000.0, 25.0), rel=1e-6)  # noiseless: rounding of the bisection


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


def test_refusals() -> None:
    with pytest.raises(FitError, match="2 different speeds"):
        fit_speed_curve("thrust", "forward", [100.0, 200.0], [1.0, 4.0])
    with pytest.raises(FitError, match="against the rotation at 300 rad"):
        fit_speed_curve("thrust", "forward", [100.0, 200.0, 300.0], [-1.0, -4.0, -9.0])


def test_standard_errors_hold_the_tare() -> None:
    # 300 logs of 19 points of noise σ, whose zero is the mean of two more: the stated error must cover the
    # scatter of the coefficients, which without the tare it misses by a factor of two.
    speed = np.linspace(100.0, 700.0, 19)
    found, stated, plain = [], [], []
    source = np.random.default_rng(4)
    for _ in range(300):
        torque = 1.65e-7 * speed**2 + source.normal(0.0, 1e-4, 19) - source.normal(0.0, 1e-4, 2).mean()
        fit = fit_speed_curve("torque", "forward", speed, torque, zero_rows=2)
        found.append(fit.coefficients)
        stated.append(fit.standard_errors)
        plain.append(fit_speed_curve("torque", "forward", speed, torque).standard_errors)
    scatter = np.std(found, axis=0)
    # 300 samples fix a scatter to 4 %; the residual's own spread (19 points) adds 15 % to each stated one.
    np.testing.assert_allclose(np.median(stated, axis=0), scatter, rtol=0.15)
    assert np.all(np.median(plain, axis=0) < 0.7 * scatter)


@pytest.mark.parametrize(
    "name", ["sar_IM_StepsTestV2_2024-02-06_131025.csv", "sar_SOV5_StepsTestV2_2024-02-06_103903.csv"]
)
def test_real_static_logs(name: str) -> None:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"real static log {name} is not beside the project (shared/data/rcbenchmark)")
    log = load(path)
    for quantity in ("thrust", "torque"):
        fit = fit_speed_curve(quantity, "forward", log["speed"].values, log[quantity].values)
        # Required: 0.99; both motors reach 0.998 or better, the paper's figure.
        assert fit.r_squared >= 0.998, fit
        assert fit.points > 40
