"""What a fit is good for: numbers in the units of use, predicted for trials that it has not seen, and a word.

A fit may leave more than noise and yet predict what its user needs: where a drone comes to rest, and when.
So every trial that was not fitted is predicted by draws of the fit (`sysid.trust.draws`), each with errors of
its own: the start within the noise that measured it, stated values of the trial within their errors, the
capture's noise on what is simulated. Simulation and measurement are then read alike, so that a band of 95 %
should hold 95 % of the measured numbers. The word says whether it does:

========================  ===================================================================================
predicts                  the bands hold 90 % of the numbers or more
predicts roughly          they hold 75 % or more
does not predict          they hold less: `sysid landing-map` and its like refuse the sets without --anyway
========================  ===================================================================================

95 % is what right bands hold on average; of some twenty numbers they hold 90 % or more in nine campaigns of
ten (binomial), and 75 % or more practically always. Fewer than `FEW` numbers earn no word. A class of
landing counts as a number that is held where most draws have it. The widths of the bands are stated beside
the word, because a band that holds everything may be wider than what a user needs.

What the words mean, on campaigns of `tests/benchmarks/use.py` (six drops or three motor logs fitted in one
run, two predicted; samples: share of the held-out samples without noise inside the bands):

==============================  =============  ================  ===========  =======
campaign                        fit / noise    word              right        samples
==============================  =============  ================  ===========  =======
right LF, seeds 1, 2, 3         1.01 to 1.07   predicts          29 of 30     99 %
right LF, seed 4                1.09, roughly  does not predict  6 of 12      48 %
right motor, 1, 2, 4, 5, 6      0.80 to 0.90   predicts          133 of 135   99 %
right motor, seed 3             0.81           predicts roughly  24 of 27     79 %
LF, body_mass 15 % off          1.50, not      predicts roughly  8 of 10      79 %
LF, kinetic_friction 15 % off   1.32, not      predicts          10 of 10     92 %
LF, body_inertia 15 % off       2.61, not      predicts          9 of 10      89 %
LF, three foreign terms, 301    1.30, not      predicts          12 of 12     90 %
LF, three foreign terms, 302    1.82, not      does not predict  7 of 12      67 %
==============================  =============  ================  ===========  =======

A wrong value or foreign physics need not spoil what is predicted: the bands are wider where noise does not
explain the fit. A fit near the noise may still predict badly, and the word is what says so.
"""

from collections.abc import Iterable

import numpy as np

from sysid.documents import Part, rounded
from sysid.fit.story import Read

PREDICTS, ROUGHLY, NOT = "predicts", "predicts roughly", "does not predict"
# Least share of the numbers that the bands hold [1], by word.
SHARES = {PREDICTS: 0.90, ROUGHLY: 0.75}
# Least number of predicted numbers that earn a word.
FEW = 5
# Quantiles of a band [1].
_BAND = (0.025, 0.975)


class NumberOfUse(Part):
    """A number of a trial that was not fitted: measured, of the best set, and 95 % of the draws [`unit`].

    An end is infinite where too many draws do not have the number; such a band predicts nothing.
    """

    what: str
    unit: str
    measured: float
    predicted: float
    low: float
    high: float

    @property
    def held(self) -> bool:
        """Whether the band holds the measured number."""
        return bool(np.isfinite([self.low, self.high]).all() and self.low <= self.measured <= self.high)


class ClassOfUse(Part):
    """How a trial ends, in words: as measured, by most draws, and the share of the draws that end so [1]."""

    measured: str
    predicted: str
    share: float


class Width(Part):
    """What the bands and errors of one number are over the trials: medians [`unit`]."""

    what: str
    unit: str
    half_width: float
    error: float
    held: int
    count: int


class Use(Part):
    """The word on all predicted numbers, how many of them the bands hold, and how wide the bands are."""

    # "" where the numbers are too few, or the fit has no draws.
    word: str
    # Whether draws of a fit stand behind the bands; else errors of the start and of stated values alone.
    drawn: bool
    held: int
    count: int
    classes_right: int
    classes: int
    widths: list[Width]

    @property
    def in_widths(self) -> str:
        """The half-widths in words, each with its unit on one line."""
        parts = (f"{each.what} ±\u00a0{rounded(each.half_width, 2)}\u00a0{each.unit}" for each in self.widths)
        return ", ".join(parts)

    @property
    def sentence(self) -> str:
        """The word with its reasons."""
        if not self.word:
            return ""
        landed = f"; the class of the landing is right in {self.classes_right} of {self.classes}"
        return (
            f"{self.word}: 95 % bands of draws hold {self.held} of {self.count} numbers of use"
            f"{landed if self.classes else ''}; half-widths (median): {self.in_widths}"
        )


def numbers_of_use(read: Iterable[Read]) -> list[NumberOfUse]:
    """Return the numbers that a measurement shows, beside what the draws make of them."""
    out = []
    for what, unit, values in read:
        if not np.isfinite(values[0]):
            continue
        # Draws without the number have it later, if ever.
        low, high = np.quantile(np.nan_to_num(values[2:], nan=np.inf), _BAND, method="nearest")
        out.append(
            NumberOfUse(
                what=what, unit=unit, measured=float(values[0]), predicted=float(values[1]),
                low=float(low), high=float(high),
            )
        )  # fmt: skip
    return out


def class_of_use(words: list[str]) -> ClassOfUse:
    """Return how a trial ends, from the words for the measurement, the best set and the draws."""
    drawn, counts = np.unique(words[2:], return_counts=True)
    share = float(np.mean([word == words[0] for word in words[2:]]))
    return ClassOfUse(measured=words[0], predicted=str(drawn[np.argmax(counts)]), share=share)


def judged_use(trials: Iterable[tuple[list[NumberOfUse], ClassOfUse | None]], *, drawn: bool) -> Use:
    """Return the word on the numbers and classes of trials; none where nothing was `drawn`."""
    pairs = list(trials)
    groups: dict[tuple[str, str], list[NumberOfUse]] = {}
    for numbers, _ in pairs:
        for number in numbers:
            groups.setdefault((number.what.split(",")[0], number.unit), []).append(number)
    classes = [each for _, each in pairs if each is not None]
    right = sum(each.measured == each.predicted for each in classes)
    held = sum(number.held for numbers in groups.values() for number in numbers)
    count = sum(map(len, groups.values()))
    # A class counts as a number does.
    asked = count + len(classes)
    words = [word for word, share in SHARES.items() if asked and (held + right) / asked >= share]
    widths = [
        Width(
            what=what, unit=unit, held=sum(each.held for each in numbers), count=len(numbers),
            half_width=float(np.median([(each.high - each.low) / 2 for each in numbers])),
            error=float(np.median([abs(each.predicted - each.measured) for each in numbers])),
        )
        for (what, unit), numbers in groups.items()
    ]  # fmt: skip
    return Use(
        word=[*words, NOT][0] if drawn and asked >= FEW else "", drawn=drawn, held=held, count=count,
        classes_right=right, classes=len(classes), widths=widths,
    )  # fmt: skip
