"""Trust on problems whose answer is known in closed form: linear models with noise of known correlation."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from sysid.fit.problem import Problem
from sysid.fit.trial import Block, NoiseModel, Trial, nrmse_of
from sysid.parameters import Parameter, ParameterTable, SearchSpace
from sysid.trust.assessment import Assessment, assess, bootstrap, leave_one_out, linearize, refit
from sysid.trust.influence import influence
from sysid.trust.least_squares import search_around, solve
from sysid.trust.linearized import NORMAL_95, bounded_information, half_widths, information, noise_model
from sysid.trust.problem import jacobian, scales
from sysid.trust.profiles import ends
from sysid.trust.sensitivity import drawn_outlooks, expectations, rank_candidates
from sysid.trust.verdicts import sentences, verdict
from sysid.workflows.check import _verdicts


def _space(n, scale="linear"):
    low, high = (0.1, 10.0) if scale == "log" else (0.0, 2.0)
    rows = [Parameter(f"p{i}", f"p_{i}", "N", 1.0, low, high, scale, "A number.", "test") for i in range(n)]
    return SearchSpace(ParameterTable(rows), tuple(rows), {})


@dataclass(eq=False)
class Linear:
    """Trials of one or two channels, each ``y = A p + noise``; derivatives and covariances are matrices."""

    designs: list  # per trial (n_samples, n_parameters, n_channels)
    data: list  # per trial (n_samples, n_channels)
    noise: float = 0.1
    rows: np.ndarray = field(default_factory=lambda: np.zeros(0))
    scale: str = "linear"
    bend: float = 0.0
    common = 0
    remedy = ""
    small = 0.0
    layout, at_stated_scale = Problem.layout, Problem.at_stated_scale

    def only(self, names):
        kept = [self.names.index(name) for name in names]
        return replace(self, designs=[self.designs[t] for t in kept], data=[self.data[t] for t in kept])

    def __post_init__(self):
        self.space = _space(self.designs[0].shape[1], self.scale)
        self.names = tuple(f"trial-{t}" for t in range(len(self.designs)))
        self.trials = tuple(
            Trial(name, "fit", np.arange(len(y), dtype=float), y, np.ones(y.shape, bool), {}, 0.0)
            for name, y in zip(self.names, self.data, strict=True)
        )
        self.channels = tuple(f"c{c}" for c in range(self.data[0].shape[1]))
        blocks, start = [], 0
        for t, y in enumerate(self.data):
            for c in range(y.shape[1]):
                n = len(y)
                weight = 1 / len(self.data) / y.shape[1]
                blocks.append(Block(t, c, start, start + n, n, weight, 1.0, self.noise))
                start += n
        self.blocks = tuple(blocks)

    def residuals(self, cube):
        p = self.space.decode(np.atleast_2d(cube))
        p = p + self.bend * np.sin(40 * p)
        parts = [
            p @ a[:, :, c].T - y[:, c]
            for a, y in zip(self.designs, self.data, strict=True)
            for c in range(y.shape[1])
        ]
        return np.concatenate(parts, axis=1), np.zeros(len(p), dtype=bool)

    def compared(self, rows):
        return self.residuals(self.space.encode(rows))

    def phases(self, trial, row):
        return [(0.0, "throughout")]

    def correlation(self):
        return NoiseModel(tuple(range(len(self.channels))), np.eye(len(self.channels))[:, :, None])

    def disturbances_at(self, row):
        return self.disturbances(row)

    def disturbances(self, cube):
        return self.rows.reshape(-1, self.blocks[-1].stop)

    def scaled(self, level=0.1):
        """The weights of the residuals where every block scores `level`."""
        return scales(self, self.blocks, np.full(len(self.blocks), level))


def _white(n_trials=3, n=200, n_par=2, seed=1, sigma=0.1, true=1.0, kernel=(1.0,)):
    source = np.random.default_rng(seed)
    designs, data = [], []
    kernel = np.asarray(kernel) / np.linalg.norm(kernel)
    for _ in range(n_trials):
        a = source.standard_normal((n, n_par, 1))
        # Slow regressors: correlated noise matters to them.
        a = np.cumsum(a, axis=0) / np.sqrt(n)
        e = np.convolve(source.standard_normal(n + len(kernel) - 1), kernel, "valid")
        designs.append(a)
        data.append((a[:, :, 0] @ np.full(n_par, true) + sigma * e)[:, None])
    return designs, data


def test_a_linear_model_gets_the_intervals_of_least_squares():
    designs, data = _white()
    problem = Linear(designs, data)
    found = assess(problem, np.array([0.4, 0.6]), resamples=0)
    a, y = np.concatenate(designs)[:, :, 0], np.concatenate(data)[:, 0]
    exact, *_ = np.linalg.lstsq(a, y, rcond=None)
    sigma = 0.1 * np.sqrt(np.diag(np.linalg.inv(a.T @ a)))
    best = problem.space.decode(found.linear.point)
    # Blocks are weighted by their own NRMSE, equal to some percent: so is the estimate, in shares of sigma.
    assert np.all(np.abs(best - exact) < 0.15 * sigma)
    for i, profile in enumerate(found.profiles.profiles):
        half = (profile.interval_95[1] - profile.interval_95[0]) / 2
        # Noise level and correlation are estimated from 600 samples: 10 % of the width at two deviations.
        assert half == pytest.approx(NORMAL_95 * sigma[i], rel=0.15)
        narrow = (profile.interval_68[1] - profile.interval_68[0]) / 2
        # A parabola: the intervals are as the roots of their limits.
        assert half / narrow == pytest.approx(np.sqrt(3.841459 / 0.988946), rel=0.02)
        assert profile.open_95 == (False, False)


def test_correlated_noise_widens_the_interval_as_its_covariance_says():
    kernel = np.ones(6)
    ratios = []
    for seed in range(6):
        designs, data = _white(seed=seed, kernel=kernel, n=300)
        linear = linearize(Linear(designs, data), np.array([0.5, 0.5]))
        n = len(data[0])
        h = kernel / np.linalg.norm(kernel)
        acf = np.convolve(h, h[::-1])[len(h) - 1 :]
        lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        covariance = 0.01 * np.where(lag < len(acf), acf[np.minimum(lag, len(acf) - 1)], 0.0)
        inverse = np.linalg.inv(sum(a[:, :, 0].T @ a[:, :, 0] for a in designs))
        exact = inverse @ sum(a[:, :, 0].T @ covariance @ a[:, :, 0] for a in designs) @ inverse
        # The cube is 2 wide.
        ratios.append(2 * linear.information.sigma / np.sqrt(np.diag(exact)))
        plain = 0.1 * np.sqrt(np.diag(inverse))
        assert np.all(np.sqrt(np.diag(exact)) > 1.5 * plain)
    # The correlation of 900 samples is known to some tenths; six draws average to within 15 %.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


def test_what_the_fit_takes_as_known_counts():
    designs, data = _white()
    size = sum(len(y) for y in data)
    pushed = np.concatenate([designs[0][:, 0, 0], np.zeros(size - len(data[0]))])[None] * 0.05
    plain = linearize(Linear(designs, data), np.array([0.5, 0.5]))
    more = linearize(Linear(designs, data, rows=pushed), np.array([0.5, 0.5]))
    a = np.concatenate(designs)[:, :, 0]
    moved = np.linalg.inv(a.T @ a) @ a.T @ pushed[0] / 2
    expected = np.sqrt(plain.information.sigma**2 + moved**2)
    # The residuals lose the part that the disturbance explains, a few percent of their variance.
    assert more.information.sigma == pytest.approx(expected, rel=0.1)
    assert more.information.sigma[0] > 1.5 * plain.information.sigma[0]


def test_a_parameter_that_nothing_sees_is_open_and_not_identifiable():
    designs, data = _white(n_par=2)
    blind = [np.concatenate([a, np.zeros((len(a), 1, 1))], axis=1) for a in designs]
    problem = Linear(blind, data)
    found = assess(problem, np.array([0.5, 0.5, 0.3]), resamples=0)
    last = found.profiles.profiles[2]
    assert last.open_95 == (True, True)
    assert last.interval_95 == (0.0, 2.0)
    assert verdict(last.half_width) == "not_identifiable"
    assert verdict(found.linear.half_widths[2]) == "not_identifiable"
    assert [verdict(p.half_width) for p in found.profiles.profiles[:2]] == ["well", "well"]


def test_two_parameters_that_trade_name_each_other_and_widen_each_other():
    source = np.random.default_rng(4)
    designs, data = _white(n_par=1)
    both = [np.concatenate([a, a + 0.02 * source.standard_normal(a.shape)], axis=1) for a in designs]
    data = [(a[:, :, 0] @ np.ones(2) + 0.1 * source.standard_normal(len(a)))[:, None] for a in both]
    alone = linearize(Linear(designs, [y / 2 for y in data]), np.array([0.5]))
    linear = linearize(Linear(both, data), np.array([0.5, 0.5]))
    partners = linear.information.partners(("p0", "p1"))
    assert partners[0][0].name == "p1"
    assert partners[0][0].correlation < -0.99
    assert linear.information.sigma[0] > 5 * alone.information.sigma[0]


def test_a_bump_inside_does_not_end_an_interval():
    place = np.linspace(0.5, 1.0, 5)
    assert ends(place, np.array([0.0, 1.0, 5.0, 1.0, 2.0]), 3.84) == (None, None)
    below, above = ends(place, np.array([0.0, 4.5, 1.0, 9.0, 16.0]), 4.0)
    assert below is None
    # Between 1 and 3 on the scale of the square root, in the middle.
    assert above == pytest.approx(0.8125)


def test_an_interval_that_a_bound_cuts_is_open_on_that_side_alone():
    designs, data = _white(true=0.005, n=60, sigma=0.3)
    found = assess(Linear(designs, data, noise=0.3), np.array([0.05, 0.05]), resamples=0)
    for profile in found.profiles.profiles:
        assert profile.open_95 == (True, False)
        assert profile.interval_95[0] == 0.0


class Winding(Linear):
    """The same in other coordinates: the second and the third wind around those before them."""

    def residuals(self, cube):
        p = self.space.decode(np.atleast_2d(cube))
        wave = np.sin(10 * (p - 1))
        straight = p - 0.3 * np.column_stack([np.zeros(len(p)), wave[:, 0], wave[:, 1]])
        return super().residuals(self.space.encode(straight))


@pytest.mark.parametrize(("steep", "seed"), [(5.0, 1), (20.0, 1), (20.0, 4)])
def test_a_profile_follows_a_winding_valley(steep, seed):
    designs, data = _white(n=60, n_par=3, sigma=1.0, seed=seed)
    steeper = [a * np.array([1.0, steep, steep])[:, None] for a in designs]
    data = [y + (b - a)[:, :, 0].sum(axis=1)[:, None] for y, a, b in zip(data, designs, steeper, strict=True)]
    intervals = []
    for kind in (Linear, Winding):
        found = assess(kind(steeper, data, noise=1.0), np.full(3, 0.5), resamples=0)
        intervals.append(found.profiles.profiles[0].interval_95)
    # The first coordinate is the same in both, so its interval is, too. It is less than half as wide where
    # a fit that has not come to its end counts as an end of the interval.
    assert intervals[1] == pytest.approx(intervals[0], abs=0.01)


def test_a_rough_derivative_is_not_trusted():
    designs, data = _white()
    smooth = Linear(designs, data)
    rough = Linear(designs, data, bend=0.02)
    point = np.array([0.5, 0.5])
    assert jacobian(smooth, point, smooth.scaled(), 0.01).trusted.all()
    # sin(40 p) with an amplitude of 0.02 changes the slope by 80 % within a step of 0.05 of the cube.
    assert not jacobian(rough, point, smooth.scaled(), 1.0).trusted.any()


def test_only_a_verdict_that_could_be_another_one_is_called_rough():
    problem = Linear(*_white(n_par=3))
    view, expected = expectations(problem, np.full(3, 0.5), problem.correlation())
    # With derivatives wrong by half of themselves the last one stays beyond the limit of 0.5.
    widths = np.array([0.05, 0.7, 0.9])
    rows = [row.model_copy(update={"half_width": w}) for row, w in zip(expected, widths, strict=True)]
    view = replace(view, half_widths=widths, jacobian=replace(view.jacobian, doubt=np.full(3, 0.5)))
    lines = _verdicts(problem, view, rows, [], "drop")["sentences"]
    assert "rough verdicts, because the derivatives depend on their step: p_0, p_1" in lines


def test_richardson_takes_the_cubic_error_away():
    designs, data = _white()
    problem = Linear(designs, data, scale="log")
    scale = np.ones(problem.blocks[-1].stop)
    point = np.array([0.5, 0.4])
    exact = np.concatenate(designs)[:, :, 0] * problem.space.decode(point) * np.log(100.0)
    found = jacobian(problem, point, scale, 1.0)
    # The longest displacement, 0.05 of the cube.
    step = 0.05 * np.log(100.0)
    # Central differences of an exponential err by h²/6; what is left is of the order h⁴.
    error = np.abs(found.values - exact).max() / np.abs(exact).max()
    assert error < 0.02 * step**2 / 6


def test_leaving_one_trial_out_is_the_fit_without_it():
    designs, data = _white()
    problem = Linear(designs, data)
    linear = linearize(problem, np.array([0.5, 0.5]))
    found = refit(problem, linear, 1 - np.eye(3), 1e-12)
    for t in range(3):
        weight = [1 / level for level in linear.levels]
        kept = [k for k in range(3) if k != t]
        a = np.concatenate([designs[k][:, :, 0] * np.sqrt(weight[k]) for k in kept])
        y = np.concatenate([data[k][:, 0] * np.sqrt(weight[k]) for k in kept])
        exact, *_ = np.linalg.lstsq(a, y, rcond=None)
        assert problem.space.decode(found.points[t]) == pytest.approx(exact, abs=1e-6)
    assert found.converged.all()


def test_the_bootstrap_draws_whole_trials_and_spreads_as_they_do():
    problem = Linear(*_white(n_trials=12, n=80, seed=3))
    linear = linearize(problem, np.array([0.5, 0.5]))
    found = bootstrap(problem, linear, 200, 5)
    # Twelve trials tell a spread to a fifth (1/sqrt(2·12)), and a resample of them is somewhat narrower.
    assert found.points.std(axis=0) == pytest.approx(linear.information.sigma, rel=0.45)


def test_fronts_do_not_depend_on_their_neighbours():
    problem = Linear(*_white())
    scale = np.ones(problem.blocks[-1].stop)
    starts = np.array([[0.1, 0.9], [0.5, 0.5], [0.8, 0.2]])
    together = solve(problem, starts, scale, rise=1e-6, tolerance=1e-12)
    alone = solve(problem, starts[1:2], scale, rise=1e-6, tolerance=1e-12)
    assert together.points[1] == pytest.approx(alone.points[0], abs=1e-9)


def test_fixed_coordinates_stay():
    problem = Linear(*_white())
    fixed, start, ones = np.array([[True, False]]), np.array([[0.3, 0.5]]), np.ones(problem.blocks[-1].stop)
    found = solve(problem, start, ones, rise=1e-6, fixed=fixed)
    assert found.points[0, 0] == 0.3
    point, squares, spent = search_around(problem, start[0], np.full(2, 0.1), ones, fixed[0], 1)
    assert point[0] == 0.3
    # CMA-ES ends where least squares ends, to what 16 generations of twelve resolve.
    assert squares == pytest.approx(found.squares[0], rel=1e-3)
    assert spent > 100


def test_the_weights_make_the_gradient_that_of_the_mean_nrmse():
    problem = Linear(*_white())
    point = np.array([0.45, 0.62])
    values, _ = problem.residuals(point[None])
    levels = nrmse_of(problem.blocks, values[0])
    scale = scales(problem, problem.blocks, levels)
    step = 1e-6
    for i in range(2):
        moved = np.tile(point, (2, 1))
        moved[:, i] += [step, -step]
        both, _ = problem.residuals(moved)
        weights = np.array([block.weight for block in problem.blocks])
        cost = nrmse_of(problem.blocks, both) @ weights
        half = np.sum((both * scale) ** 2, axis=1) / 2
        assert np.diff(half)[0] == pytest.approx(np.diff(cost)[0], rel=1e-5)


def test_white_noise_counts_every_sample():
    source = np.random.default_rng(0)
    n = 4000
    blocks = [Block(0, 0, 0, n, n, 1.0, 1.0, 1.0)]
    model = noise_model(blocks, source.standard_normal(n))
    assert model.inflation[0] < 1.15
    smooth = np.convolve(source.standard_normal(n + 9), np.ones(10) / 10, "valid")
    # Ten samples of a running mean of ten carry as much as one; 4000 tell that to a tenth.
    assert noise_model(blocks, smooth).inflation[0] == pytest.approx(10, rel=0.25)


@pytest.mark.parametrize(
    ("half_width", "word"),
    [
        (0.0999, "well"),
        (0.1, "weakly"),
        (0.4999, "weakly"),
        *((x, "not_identifiable") for x in (0.5, np.inf, np.nan)),
    ],
)
def test_verdicts_part_at_ten_and_fifty_percent(half_width, word):
    assert verdict(half_width) == word


def test_half_widths_are_relative_to_the_value():
    space = _space(2)
    point = np.array([0.5, 0.25])
    found = half_widths(space, point, np.array([0.01, 0.01]))
    assert found == pytest.approx(NORMAL_95 * 0.02 / np.array([1.0, 0.5]))


def test_the_recording_that_sees_the_blind_parameter_is_ranked_first():
    designs, data = _white(n_par=1)
    source = np.random.default_rng(2)
    blind = [np.concatenate([a, 1e-4 * source.standard_normal(a.shape)], axis=1) for a in designs]
    problem = Linear(blind, data)
    noise = NoiseModel((0,), np.ones((1, 1, 1)))
    view, expected = expectations(problem, np.array([0.5, 0.5]), noise)
    assert [one.verdict for one in expected] == ["well", "not_identifiable"]
    shapes = [np.array([1.0, 0.0]), np.array([0.0, 1.0]), np.array([0.0, 0.3])]
    extra = [source.standard_normal((200, 1, 1)) * shape[None, :, None] for shape in shapes]
    others = Linear(extra, [a[:, :, 0] @ np.ones(2)[:, None] for a in extra])
    titles = ("the same", "the other", "a little of it")
    ranked = rank_candidates(problem, view, others, titles, np.array([False, True]))
    assert [one.title for one in ranked] == ["the other", "a little of it", "the same"]
    # 200 samples of unit size at a noise of 0.1: sigma 0.1/sqrt(200), whatever the sample's own rms (5 %).
    assert ranked[0].half_widths["p1"] == pytest.approx(NORMAL_95 * 0.1 / np.sqrt(200), rel=0.15)
    # A linear model is as well known anywhere; relative to a value between 0.05 and 1.95 instead of 1.
    drawn = drawn_outlooks(problem, noise)
    judged = rank_candidates(problem, view, others, titles, np.array([False, True]), drawn)
    for one, same in zip(judged, ranked, strict=True):
        values = [problem.space.decode(other.point) for other in drawn]
        expected_there = np.median(same.half_widths["p0"] / np.array(values)[:, 0])
        assert one.half_widths_over_bounds["p0"] == pytest.approx(expected_there, rel=0.05)
        assert all(one.worse(name) >= width for name, width in one.half_widths.items())
    said = sentences(expected)
    assert said[0] == "well identifiable: p_0"
    assert "p1 (p_1) is not identifiable" in said[1]


@pytest.mark.parametrize("explained", [True, False])
def test_under_a_wrong_model_the_partner_of_a_cut_parameter_cannot_be_read_either(explained):
    # p0 trades with p1, which a bound cuts; p2 stands alone.
    design = np.array([[1.0, 0.95, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 1.0]]) * 100
    known = information(design, design.T @ design)
    profiles = [SimpleNamespace(name=f"p{i}", half_width=width) for i, width in enumerate((0.01, 0.6, 0.01))]
    found = Assessment(
        SimpleNamespace(verdict="explained" if explained else "not_explained", symptoms=["p1"]),
        None, SimpleNamespace(information=known), SimpleNamespace(profiles=profiles), None, None,
    )  # fmt: skip
    right, wrong = ("well", "not_identifiable", "well"), ("not_interpretable", "not_interpretable", "weakly")
    assert found.verdicts == (right if explained else wrong)


def test_a_step_that_overshoots_is_no_convergence():
    # From a hundredth of the range of a logarithm, the linear step leads far beyond 1 and is worse than none.
    designs, data = _white(n_par=1)
    problem = Linear(designs, data, scale="log")
    start = problem.space.encode(np.array([0.11]))
    found = solve(problem, start[None], problem.scaled(), rise=1e-6, tolerance=1e-6, iterations=30)
    assert found.converged.all()
    # 600 samples of noise 0.1 on regressors of size 0.5 fix the factor 1 to under a percent.
    assert problem.space.decode(found.points[0])[0] == pytest.approx(1.0, abs=0.03)


def test_at_a_bound_the_others_find_their_own_minimum():
    designs, data = _white(seed=4)
    # Regressors that trade with each other; the first wants to be negative.
    mixed = [np.concatenate([a[:, :1], 0.9 * a[:, :1] + 0.3 * a[:, 1:]], axis=1) for a in designs]
    lowered = [y - 1.5 * a[:, 0] for y, a in zip(data, designs, strict=True)]
    problem = Linear(mixed, lowered)
    a, y = np.concatenate(mixed)[:, :, 0], np.concatenate(lowered)[:, 0]
    exact = lsq_linear(a, y, bounds=(0.0, 2.0)).x
    assert np.min(np.abs(exact)) < 1e-6
    # One step of a linear model, damped by 1e-4: a step that is merely cut at the bound ends 0.1 away.
    start = np.full((1, 2), 0.5)
    found = solve(problem, start, problem.scaled(), rise=1e-6, tolerance=1e-9, iterations=1)
    assert problem.space.decode(found.points[0]) == pytest.approx(exact, abs=5e-3)


def test_what_is_at_its_bound_takes_no_share_of_the_others_error():
    source = np.random.default_rng(2)
    jacobian_values = source.standard_normal((50, 2)) @ np.array([[30.0, 27.0], [0.0, 13.0]])
    # What is taken as known errs along the second parameter's direction mostly.
    change = jacobian_values @ np.array([0.05, 0.3])
    pushed = jacobian_values.T @ change
    spread = jacobian_values.T @ jacobian_values * 1e-3 + np.outer(pushed, pushed)
    free = information(jacobian_values, spread)
    inside, at_bound = (
        bounded_information(jacobian_values, spread, np.array([0.5, second])) for second in (0.5, 0.0)
    )
    assert np.array_equal(inside.covariance, free.covariance)
    alone = information(jacobian_values[:, :1], spread[:1, :1])
    # The second one's error is borne by the first: much more than its own.
    assert alone.sigma[0] > 2 * free.sigma[0]
    assert at_bound.sigma[0] == pytest.approx(alone.sigma[0])
    assert at_bound.inflation[0] == pytest.approx(alone.inflation[0])
    assert at_bound.sigma[1] == free.sigma[1]


def _influence(problem):
    linear = linearize(problem, np.full(2, 0.5))
    floors = np.array([block.noise for block in problem.blocks])
    return linear, influence(problem, linear, floors, leave_one_out(problem, linear))


def test_the_trial_that_decides_a_fit_is_named():
    designs, data = _white(n_trials=5, seed=3)
    _, quiet = _influence(Linear(designs, data))
    assert (quiet.held_by, quiet.outliers) == ((), ())
    # One trial of five says four times as much as another and has its own truth: the fit follows it.
    strong = [*designs[:4], 4 * designs[4]]
    source = np.random.default_rng(5)
    other = (strong[4][:, :, 0] @ np.array([1.1, 1.0]) + 0.1 * source.standard_normal(200))[:, None]
    _, found = _influence(Linear(strong, [*data[:4], other]))
    assert (4, (0,)) in found.held_by
    # Five fits of at least one step, each with two derivatives.
    assert found.evaluations >= 5 * 3
    # Without it the others' own value comes back: p_0 = 1 is 0.5 of the cube, fixed to half a percent by 800
    # samples of noise 0.1 on regressors of size 0.5.
    assert found.without[4, 0] == pytest.approx(0.5, abs=0.02)


def test_a_trial_that_scores_unlike_the_others_stands_out():
    designs, data = _white(n_trials=5, seed=3)
    source = np.random.default_rng(9)
    loud = [*data[:2], data[2] + 0.3 * source.standard_normal(data[2].shape), *data[3:]]
    _, found = _influence(Linear(designs, loud))
    assert found.outliers == (2,)
    # Noise of 0.1 and 0.3: 3.2 times the floor.
    assert found.ratio[2] == pytest.approx(np.sqrt(10), rel=0.15)
    assert np.delete(found.ratio, 2) == pytest.approx(1.0, abs=0.15)


def test_one_trial_less_is_judged_by_what_a_parameter_at_its_bound_leaves_to_the_others():
    designs, _ = _white(n_trials=5, seed=3)
    mixed = [np.concatenate([a[:, :1], 0.9 * a[:, :1] + 0.3 * a[:, 1:]], axis=1) for a in designs]
    source = np.random.default_rng(6)
    # The second parameter wants to be -0.02 and ends at its bound 0.
    low = [(a[:, :, 0] @ np.array([1.0, -0.02]) + 0.02 * source.standard_normal(200))[:, None] for a in mixed]
    change = np.concatenate(mixed)[:, :, 0] @ np.array([0.02, 0.1])
    linear, found = _influence(Linear(mixed, low, rows=change[None]))
    assert linear.point[1] < 0.01
    expected = (found.without[:, 0] - linear.point[0]) / found.shift[:, 0]
    # All trials share what is taken as known, so the variance without one is that with it, and a fifth of it
    # counts. With the second parameter held, its error of 0.1 is the first one's by 0.9: 0.11 of a cube that
    # is 2 wide (noise adds less than a percent). Both free, the first would err by 0.02, a fifth of that.
    assert expected == pytest.approx(np.full(5, np.sqrt(0.2) * 0.11 / 2), rel=0.1)


def test_where_noise_does_not_explain_the_trials_intervals_cover_what_a_trial_less_moves():
    designs, data = _white(n_trials=5)
    right = assess(Linear(designs, data), np.full(2, 0.5), resamples=0)
    assert right.adequacy.verdict == "explained"
    assert right.linear is right.noise
    # The model lacks a slow wave that is alike in all trials, and stronger in the last one.
    wave = np.sin(np.linspace(0.0, 7.0, 200))[:, None]
    wrong = Linear(designs, [y + (0.6 if t == 4 else 0.3) * wave for t, y in enumerate(data)])
    found = assess(wrong, np.full(2, 0.5), resamples=20)
    assert found.adequacy.verdict == "not_explained"
    assert found.adequacy.misfit.trial == "trial-4"
    assert "well" not in found.verdicts
    moved = np.max(np.abs(found.without.points - found.noise.point), axis=0)
    for i, (profile, before) in enumerate(zip(found.profiles.profiles, right.profiles.profiles, strict=True)):
        low, high = profile.interval_95
        # Bounds 0 to 2: a way in the unit cube is half of it in the parameter.
        assert (high - low) / 2 > 2 * moved[i] * 0.99
        assert high - low > 2 * (before.interval_95[1] - before.interval_95[0])
        assert low < 1.0 < high
    # Every resample counts.
    assert found.resampled.converged.all()
