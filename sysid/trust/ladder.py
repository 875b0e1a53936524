"""What is missing in a model: declared terms added to a fit, judged on its noise and on trials left out.

Each term is added alone. Terms hide one another, so that no order of adding them is safe; those to keep are
found from above: all are fitted together, from where the best single term ends, and the least certain one is
taken away until every one that is left is needed. Where a fit with fewer terms has a lower NRMSE, the fit
with more had stopped too early; it is repeated from there. Several terms that may be chance are taken away
between two fits: the other values and their covariance are conditioned, as in a normal distribution, on the
value of a term that is off. A term is needed where

* its value differs from none by more than chance: a Wald test with the covariance of
  `sysid.trust.linearized`, with misfit as in `sysid.trust.assessment`, times the number of terms looked at
  (Bonferroni), and
* with the least certain one, too, the trials left out are predicted better on average.

Where noise does not explain the trials and no value is certain, a term is kept that alone predicts the
trials left out better by more than chance. To leave out is to fit again without each trial in turn, or each
part of one (`Problem.pieces`). A trial's gain is the logarithm of the factor by which its residual over
noise falls, root mean square over its channels: in NRMSE velocities, which are mostly noise, hide what a
term does to the positions. If a term buys nothing, every gain may as well have the other sign: the chance is
the share of all sign changes under which the best of the terms looked at gains as much on average
(max-statistic, Westfall & Young 1993). Simpler models of a kind are judged so, the fit's model as what it
adds to each.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from sysid.errors import FitError
from sysid.fit.adequacy import EXPLAINED_BY, adequacy
from sysid.fit.kind import Term
from sysid.fit.least_squares import RISE
from sysid.fit.problem import Problem
from sysid.fit.trial import nrmse_of
from sysid.journal import Say
from sysid.parameters import SearchSpace
from sysid.trust.assessment import linearize_widened
from sysid.trust.least_squares import solve
from sysid.trust.problem import derivatives, scales
from sysid.trust.terms import TOLERANCE, downhill, freed, starting_point
from sysid.types import FloatArray

# Largest probability of chance of a single term, or of a model against a simpler one, that counts as needed
# [1].
CHANCE = 0.05
# Largest probability of chance of a term that is kept in the joint fit [1]: smaller, because a few trials
# state the covariance badly.
CERTAIN = 1e-3
# Least mean gain, the logarithm of the ratio of misfits, of a term that is kept [1].
LEAST_GAIN = 0.01
# Least number of trials or parts: of the sign changes of five one in 32 has all gains above zero, so that
# fewer cannot tell a gain from chance.
FEWEST = 5
# Largest number of sign changes against which gains are compared: all changes of up to 12 trials or parts,
# random changes of more.
_CHANGES = 4096
# Starts of a term's walks, less the term's value in the paper's model [unit cube]: the walk from 0 cannot end
# worse than the model without the term.
_STARTS = (0.0, -0.15, 0.05, 0.3)
# Share of its NRMSE by which a fit may lie above another with fewer terms [1].
_AS_LOW = 1e-3
# Number of random starts of a simpler model, besides the one at the values of the base.
_AROUND = 7
# Number of iterations of a fit without one trial or part.
_ITERATIONS_WITHOUT = 6


@dataclass(frozen=True, eq=False)
class TermFit:
    """A fit of the model with some terms."""

    # Terms that it has; none in the base. A simpler model has one that names it.
    terms: tuple[Term, ...]
    # Problem whose free parameters are the fit's, then the terms'.
    problem: Problem
    # (n,) optimum [unit cube].
    point: FloatArray
    # NRMSE over the fitted trials [1].
    nrmse: float
    # The same over what noise alone costs [1].
    ratio: float
    # (T,) NRMSE over noise of each piece, predicted by the fit of the others [1]; NaN where not computed.
    left_out: FloatArray
    # (T,) the same, root mean square over the channels [1].
    misfit: FloatArray
    # Mean gain over the rung below, and the probability that it, or the value of a term among others, is
    # chance [1]; NaN of the base. Of a simpler model: what the base gains over it.
    gain: float = np.nan
    chance: float = np.nan
    # Whether the last term is among those to keep. Of a simpler model: whether what it lacks is needed.
    kept: bool = False

    @property
    def values(self) -> dict[str, float]:
        """Value of every free parameter [SI]."""
        return dict(
            zip(self.problem.space.names, self.problem.space.decode(self.point).tolist(), strict=True)
        )


@dataclass(frozen=True, eq=False)
class Ladder:
    """The base, each term alone, those to keep together, the most certain first, and simpler models.

    Where none is to be kept, `together` is the one that gains most. Without terms there is the base alone.
    """

    base: TermFit
    alone: tuple[TermFit, ...]
    together: tuple[TermFit, ...]
    simpler: tuple[TermFit, ...]
    evaluations: int

    @property
    def best(self) -> TermFit:
        """The rung with all terms to keep; the base where no term is."""
        return self.together[-1] if self.together and self.together[-1].kept else self.base


class Climber:
    """Fits rungs and counts what they simulate."""

    def __init__(self, problem: Problem, start: FloatArray, say: Say = None) -> None:
        """Begin at the best set (n,) [unit cube] of the fitted trials."""
        self.evaluations = 0
        self._found: dict[Term, Mapping[str, float]] = {}
        self._say = say or (lambda sentence: None)
        floors = problem.floors(problem.space.full(start[None])[0])
        # A channel of unknown noise is judged by the residuals of the fit instead.
        left = nrmse_of(problem.blocks, problem.residuals(start[None])[0])[0]
        self._floors = np.where(np.isfinite(floors), floors, left)
        self._problem, self._start = problem, start
        count = len(problem.space.stated)
        self._kept = derivatives(problem, start)[-count:] if count else None

    def climb(self, terms: Sequence[Term], simpler: Sequence[tuple[str, Problem]] = ()) -> Ladder:
        """Return the base, each term alone, those to keep together, and simpler models by title.

        FitError for too few pieces to judge terms.
        """
        if terms and len(self._problem.pieces[0]) < FEWEST:
            raise FitError(
                f"{len(self._problem.pieces[0])} fitted trials: physics is judged on trials left out, and "
                f"needs {FEWEST} or more; fit more trials"
            )
        base = self._left_out(self._fitted((), self._problem, self._start[None]))
        if not terms:
            return Ladder(base, (), (), (), self.evaluations)
        alone = []
        for term in terms:
            self._say(f"{term.title}: fitted, and fitted without each trial")
            problem = freed(self._problem, (term,))
            point = starting_point(self._problem, problem, base.values)
            starts = np.repeat(point[None], len(_STARTS), axis=0)
            first = len(self._problem.space.found)
            new = slice(first, first + len(problem.space.free) - len(self._start))
            starts[:, new] = np.clip(starts[:, new] + np.array(_STARTS)[:, None], 0.0, 1.0)
            alone.append(self._left_out(self._fitted((term,), problem, starts)))
        alone = _judged(alone, base)
        self._found = {rung.terms[0]: rung.values for rung in alone}
        self._say("all terms fitted together, and again without each that is not needed")
        together = self._together(base, alone)
        if not together:
            # Under misfit no value may be certain, and the trials left out may still show a term.
            most = max(alone, key=lambda rung: rung.gain)
            row = self._problem.space.full(base.point[None])[0]
            wrong = adequacy(self._problem, row).verdict != EXPLAINED_BY
            together = [replace(most, kept=wrong and _needed(most))]
        keep = together[-1].terms if together[-1].kept else ()
        alone = [replace(rung, kept=rung.terms[0] in keep) for rung in alone]
        less = []
        for title, problem in simpler:
            self._say(f"{title}: fitted, and fitted without each trial")
            starts = starts_near(problem.space, base.values)
            rung = self._left_out(self._fitted((Term(title, ()),), problem, starts))
            over = _judged([base], rung)[0]
            less.append(replace(rung, gain=over.gain, chance=over.chance, kept=_needed(over)))
        return Ladder(base, tuple(alone), tuple(together), tuple(less), self.evaluations)

    def _together(self, base: TermFit, alone: Sequence[TermFit]) -> list[TermFit]:
        """Return the terms to keep, one more on each rung, the most certain first."""
        terms = tuple(rung.terms[0] for rung in alone)
        rung = self._fitted_near(terms, min(alone, key=lambda rung: rung.nrmse).values)
        # Lowest NRMSE of a fit with fewer terms from which the walk began again [1].
        lowest = np.inf
        while rung.terms:
            rung, chances, needed = self._by_certainty(rung, len(terms))
            if not needed and chances[-1] >= CERTAIN:
                return []
            below = self._fitted_near(rung.terms[:needed], rung.values)
            if below.nrmse < (1.0 - _AS_LOW) * min(rung.nrmse, lowest):
                # More terms hardly fit worse: the walk with all of them ended too early to tell what goes.
                rung, lowest = self._fitted_near(rung.terms, below.values), below.nrmse
                continue
            if chances[-1] < CERTAIN:
                rung, below = self._left_out(rung), self._left_out(below)
                if _gains(rung, below).mean() > LEAST_GAIN:
                    break
            rung, lowest = below, np.inf
        if not rung.terms:
            return []
        rungs = [rung]
        while len(rungs[0].terms) > 1:
            rungs.insert(0, self._left_out(self._fitted_near(rungs[0].terms[:-1], rungs[0].values)))
        return [
            replace(rung, gain=float(_gains(rung, below).mean()), chance=chance, kept=True)
            for rung, below, chance in zip(rungs, [base, *rungs], chances, strict=False)
        ]

    def _by_certainty(self, rung: TermFit, looked_at: int) -> tuple[TermFit, list[float], int]:
        """Sort a rung's terms, the most certain first; return the chance of each that its value is none.

        Return as well how many of the first stay when the least certain one goes, and with it those that may
        be chance, one after the other.
        """
        kept = self._columns(rung.problem)
        linear, space = linearize_widened(rung.problem, rung.point, kept), rung.problem.space
        rung = self._rated(rung.terms, rung.problem, linear.point, 0)
        none = {name: self._problem.space.fixed[name] for term in rung.terms for name in term.parameters}
        way = linear.point - starting_point(self._problem, rung.problem, {**rung.values, **none})
        covariance, left, gone = linear.information.covariance, list(rung.terms), list[Term]()
        chances: list[float] = []
        while left and not (gone and chances[-1] < CERTAIN):
            places = [[space.names.index(name) for name in term.parameters] for term in left]
            inverse = [np.linalg.pinv(covariance[np.ix_(of, of)], hermitian=True) for of in places]
            squares = [float(way[of] @ one @ way[of]) for of, one in zip(places, inverse, strict=True)]
            order = np.argsort([-square / len(of) for square, of in zip(squares, places, strict=True)])
            sure = [min(1.0, looked_at * float(chi2.sf(squares[i], len(places[i])))) for i in order]
            chances = chances or sure
            if gone and sure[-1] < CHANCE:
                break
            left = [left[i] for i in order]
            gone.insert(0, left.pop())
            of = places[order[-1]]
            follow = covariance[:, of] @ inverse[order[-1]]
            way, covariance = way - follow @ way[of], covariance - follow @ covariance[of]
        return replace(rung, terms=(*left, *gone)), chances, len(left)

    def _fitted_near(self, terms: tuple[Term, ...], values: Mapping[str, float]) -> TermFit:
        """Return a fit with terms, from values by name [SI], and from where the terms end alone."""
        alone = dict(values)
        for term in reversed(terms):
            alone |= self._found[term]
        problem = freed(self._problem, terms)
        starts = [starting_point(self._problem, problem, each) for each in (values, alone)]
        return self._fitted(terms, problem, np.array(starts))

    def _fitted(self, terms: tuple[Term, ...], problem: Problem, starts: FloatArray) -> TermFit:
        return self._rated(terms, problem, *downhill(problem, starts, self._columns(problem, bool(terms))))

    def _columns(self, problem: Problem, beside: bool = True) -> FloatArray | None:
        """Return the base's derivatives by stated values, for a fit `beside` the base of the same values."""
        same = problem.space.stated.keys() == self._problem.space.stated.keys()
        return self._kept if beside and same else None

    def _rated(
        self, terms: tuple[Term, ...], problem: Problem, point: FloatArray, evaluations: int
    ) -> TermFit:
        self.evaluations += evaluations
        levels = nrmse_of(problem.blocks, problem.residuals(point[None])[0])[0]
        weights = np.array([block.weight for block in problem.blocks])
        nrmse, floor = float(weights @ levels), float(weights @ self._floors)
        none = np.full(len(problem.pieces[0]), np.nan)
        return TermFit(terms, problem, point, nrmse, nrmse / floor, none, none)

    def _left_out(self, rung: TermFit) -> TermFit:
        """Fit a rung without each piece, and predict that piece.

        One set of derivatives serves all these fits, which end near by.
        """
        problem, point, blocks = rung.problem, rung.point, rung.problem.blocks
        names, piece = problem.pieces
        count = len(names)
        left = piece == np.arange(count)[:, None]
        residuals = problem.residuals(point[None])[0][0]
        scale = scales(problem, blocks, nrmse_of(blocks, residuals)) / np.sqrt(rung.nrmse)
        columns = derivatives(problem, point, self._columns(problem))
        # What the campaign states is left out with no trial.
        weights_of = np.pad(1.0 - left, ((0, 0), (0, len(residuals) - left.shape[1])), constant_values=1.0)
        solved = solve(
            problem, np.repeat(point[None], count, axis=0), scale, rise=RISE,
            weights=lambda part: weights_of[part], known=columns,
            tolerance=TOLERANCE, iterations=_ITERATIONS_WITHOUT,
        )  # fmt: skip
        self.evaluations += solved.evaluations + count
        squares = problem.residuals(solved.points)[0][:, : left.shape[1]] ** 2 * left
        starts = [block.start for block in blocks]
        valid = np.concatenate([problem.trials[b.trial].valid[:, b.channel] for b in blocks])
        counts = np.add.reduceat(left * valid, starts, axis=1)
        levels = np.sqrt(np.add.reduceat(squares, starts, axis=1) / np.maximum(counts, 1))
        weights = np.array([block.weight for block in blocks]) * (counts > 0)
        left_out = np.sum(weights * levels, axis=1) / (weights @ self._floors)
        squares = np.sum(weights * (levels / self._floors) ** 2, axis=1) / np.sum(weights, axis=1)
        return replace(rung, left_out=left_out, misfit=np.sqrt(squares))


def starts_near(space: SearchSpace, values: Mapping[str, float]) -> FloatArray:
    """Return starts (F, n) [unit cube] around values by name [SI]; names left out begin at their nominal."""
    begin = np.array([values.get(row.name, row.nominal) for row in space.free])
    point = np.clip(space.encode(begin), 0.0, 1.0)
    around = 0.15 * np.random.default_rng(0).standard_normal((_AROUND, len(point)))
    return np.clip(np.vstack([point, point + around]), 0.0, 1.0)


def _gains(rung: TermFit, below: TermFit) -> FloatArray:
    return np.asarray(np.log(below.misfit / rung.misfit))


def _needed(rung: TermFit) -> bool:
    return rung.chance < CHANCE and rung.gain > LEAST_GAIN


def _judged(rungs: Sequence[TermFit], below: TermFit) -> list[TermFit]:
    """Return rungs with their gains over the one below, and the chance of each, for all of them together."""
    gains = np.array([_gains(rung, below) for rung in rungs])
    count = gains.shape[1]
    if 2**count <= _CHANGES:
        signs = 1 - 2 * (np.arange(2**count)[:, None] >> np.arange(count) & 1)
    else:
        signs = np.random.default_rng(0).choice((-1, 1), (_CHANGES, count))
        signs[0] = 1
    means = gains.mean(axis=1)
    largest = np.max(signs @ gains.T, axis=1) / count
    return [
        replace(rung, gain=float(mean), chance=float(np.mean(largest >= mean - 1e-12)))
        for rung, mean in zip(rungs, means, strict=True)
    ]
