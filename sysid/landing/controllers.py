"""Landing controllers: the commands to the motors from the impact on, and how a drone feels the impact.

A controller is a list of steps. A new one takes ten lines::

    from sysid.landing.controllers import Step, controller

    @controller("staged")
    def staged(pause: float = 0.05) -> list[Step]:
        "Little thrust for a while, then full reverse."
        return [Step(0.0, 0.3, 0.3), Step(pause, -1.0, -1.0)]

and is then known by its name to this package, and to the command line with ``--controller-file FILE.py``.
"""

import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path

import numpy as np

from sysid.errors import CampaignError, SysidError, UnitError
from sysid.landing.settings import IDLE_COMMAND, IMPULSE_COMMAND
from sysid.plugin import fault_of, run_file
from sysid.types import FloatArray
from sysid.units import parse_quantity

STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class Sensing:
    """An accelerometer at the body's centre of mass that looks for an impact.

    The filter's delay (about 11 ms at 30 Hz) is part of the reaction time. A gentle touchdown may stay below
    the threshold: then nothing triggers, as on the real drone. Until then the motors keep the hover command.
    Without attitude control that says nothing after some tenths of a second, hence the window.
    """

    # Magnitude of the filtered specific force that is an impact [m/s²]; hovering reads 1 g.
    threshold: float = 2.0 * STANDARD_GRAVITY
    rate: float = 1000.0  # samples per second [Hz]
    corner: float = 30.0  # -3 dB corner of the causal Butterworth low-pass [Hz]
    order: int = 3  # of the low-pass
    window: float = 0.5  # time after touchdown in which an impact counts [s]

    def __post_init__(self) -> None:
        if not (
            self.threshold > 0 and self.window > 0 and 0 < 2 * self.corner < self.rate and self.order >= 1
        ):
            raise CampaignError(
                f"sensing: threshold {self.threshold:g} m/s², rate {self.rate:g} Hz, corner "
                f"{self.corner:g} Hz, order {self.order}; expected a corner below half the rate"
            )

    def trigger(self, specific_force: FloatArray) -> float:
        """Return when specific forces (n, 2) [m/s²] show an impact, from sample 0 on [s]; NaN: never."""
        from scipy.signal import butter, sosfilt, sosfilt_zi

        sos = butter(self.order, self.corner, fs=self.rate, output="sos")
        settled = sosfilt_zi(sos)
        # The filter is settled on the first sample.
        parts = (sosfilt(sos, force, zi=settled * force[0])[0] for force in specific_force.T)
        above = np.flatnonzero(np.hypot(*parts) > self.threshold)
        return float(above[0] / self.rate) if len(above) else float("nan")


@dataclass(frozen=True)
class Step:
    """Commands u of each pair of motors [1], -1 full reverse to 1 full forward, from an instant on [s]."""

    after: float
    rear: float
    front: float


@dataclass(frozen=True)
class Controller:
    """What the motors do in a landing; before the trigger they keep the hover command.

    `name` is as written, ``impulse:delay=0.05,duration=0.1``; `steps` are in the order of time. Motors of an
    `ideal_reversal` have no saturation (I_sat = ∞), as in Fig. 11. The trigger is the first contact of a
    foot, or what the drone's accelerometer does by `sensing`.
    """

    name: str
    steps: tuple[Step, ...]
    ideal_reversal: bool = False
    sensing: Sensing | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", tuple(self.steps))
        if not isinstance(self.ideal_reversal, bool):
            raise CampaignError(f"ideal_reversal = {self.ideal_reversal!r:.60}: expected true or false")
        times = [step.after for step in self.steps]
        commands = [u for step in self.steps for u in (step.rear, step.front)]
        if not times or times != sorted(times) or not all(0 <= t < math.inf for t in times):
            raise CampaignError(
                f"controller {self.name!r}: steps at {times} s; give one or more in the order of time"
            )
        if not all(-1 <= u <= 1 for u in commands):
            raise CampaignError(
                f"controller {self.name!r}: commands {commands}; expected -1 to 1, 1 being full forward"
            )

    @property
    def label(self) -> str:
        """Name with its options, for tables and figures."""
        options = (", ideal reversal", self.ideal_reversal), (", accelerometer trigger", self.sensing)
        return self.name + "".join(words for words, given in options if given)

    def check_within(self, horizon: float) -> None:
        """Refuse a step that comes when the simulated time [s] is over: often milliseconds were meant."""
        late = [step.after for step in self.steps if step.after >= horizon]
        if late:
            raise CampaignError(
                f"controller {self.name!r}: a step at {late[0]:g} s, but only {horizon:g} s are simulated; a "
                "number without unit is in seconds: write 50ms for milliseconds, or raise --horizon"
            )


Recipe = Callable[..., Sequence[Step]]
CONTROLLERS: dict[str, Recipe] = {}


def controller(name: str) -> Callable[[Recipe], Recipe]:
    """Register a function of plain numbers [SI], its options, that returns the steps of a controller."""

    def register(recipe: Recipe) -> Recipe:
        CONTROLLERS[name] = recipe
        return recipe

    return register


@controller("off")
def off() -> list[Step]:
    """Shut the motors off at impact: the paper's baseline, 0 %."""
    return [Step(0.0, 0.0, 0.0)]


@controller("reverse")
def reverse() -> list[Step]:
    """Full reverse thrust on all motors at impact, -100 %."""
    return [Step(0.0, -1.0, -1.0)]


@controller("command")
def command(u: float) -> list[Step]:
    """One command on all motors at impact."""
    return [Step(0.0, u, u)]


@controller("impulse")
def impulse(
    delay: float,
    duration: float,
    after: float = -1.0,
    front: float = IMPULSE_COMMAND,
    rear: float = IDLE_COMMAND,
    idle: float = IDLE_COMMAND,
) -> list[Step]:
    """Idle at impact, after a delay an impulse of the front pair against the pitching, then full reverse."""
    steps = [Step(0.0, idle, idle), Step(delay, rear, front), Step(delay + duration, after, after)]
    # A step that the next one replaces at once commands nothing.
    until = [delay, delay + duration, math.inf]
    return [step for step, end in zip(steps, until, strict=True) if end > step.after]


def find_controller(text: str, *, ideal_reversal: bool = False, sensing: Sensing | None = None) -> Controller:
    """Return a controller as the command line names it.

    `text` is a name, then its options by name or in order: ``reverse``, ``command:-0.5``,
    ``impulse:delay=50ms,duration=0.1``; a number without unit is SI. Raises `CampaignError` for a controller
    or options that are not known, and for steps that are out of order or no commands.
    """
    name, _, options = str(text).partition(":")
    recipe = CONTROLLERS.get(name.strip())
    if recipe is None:
        raise CampaignError(f"no controller {name!r}; known are {', '.join(CONTROLLERS)}")
    signature = inspect.signature(recipe)
    given: list[float] = []
    named: dict[str, float] = {}
    for part in filter(None, (piece.strip() for piece in options.split(","))):
        key, equals, value = part.rpartition("=")
        number = read_number(value, "1" if value.endswith("%") else "s", f"controller {text!r}")
        if equals:
            named[key.strip()] = number
        else:
            given.append(number)
    try:
        bound = signature.bind(*given, **named)
    except TypeError as error:
        wanted = ", ".join(str(name) for name in signature.parameters) or "none"
        raise CampaignError(
            f"controller {text!r}: {error}; its options are {wanted}, as in impulse:delay=50ms,duration=0.1"
        ) from None
    # The recipe may be a user's: its faults are named with file and line.
    source = Path(recipe.__code__.co_filename) if inspect.isfunction(recipe) else Path(__file__)
    try:
        steps = list(recipe(*bound.args, **bound.kwargs))
    except SysidError:
        raise
    except Exception as error:
        raise CampaignError(f"controller {text!r}: {fault_of(source, error)}; mend the function") from error
    for step in steps:
        if not isinstance(step, Step) or not all(
            isinstance(value, Real) for value in (step.after, step.rear, step.front)
        ):
            line = recipe.__code__.co_firstlineno if inspect.isfunction(recipe) else 0
            raise CampaignError(
                f"controller {text!r}: {source}, line {line}: the function returned {step!r}; expected a "
                "list of Step(after, rear, front) of numbers"
            )
    return Controller(text, tuple(steps), ideal_reversal, sensing)


def read_number(value: str, unit: str, where: str) -> float:
    """Return a number of the command line: SI, or with a unit of the dimension of `unit`."""
    try:
        number = float(value)
    except ValueError:
        try:
            number = parse_quantity(value, unit)
        except UnitError as error:
            raise CampaignError(f"{where}: {error}") from None
    if not math.isfinite(number):
        raise CampaignError(f"{where}: {value!r} is not finite; give a number, with its unit or in SI")
    return number


def load_controllers(path: Path) -> None:
    """Run a user's Python file that registers controllers; refuse one that cannot be run or has none."""
    before = dict(CONTROLLERS)
    try:
        run_file(path, "that registers a controller")
    except Exception:
        CONTROLLERS.clear()
        CONTROLLERS.update(before)
        raise
    if before == CONTROLLERS:
        raise CampaignError(
            f"{path}: registers no controller; decorate a function with sysid.landing.controllers.controller"
        )
