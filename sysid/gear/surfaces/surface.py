"""What a surface declares: its compiled friction law, the parameters it reads, and what is free on it."""

import inspect
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from sysid.gear.kernel.dynamics import accelerations, foot_looseness
from sysid.gear.kernel.parameter_row import LAW_SLOTS
from sysid.integrate.fused import fused
from sysid.types import Compiled

# Parameters that are free on every surface by default.
LEGS_AND_GROUND = (
    "joint_dx", "joint_dz", "leg_axial_stiffness", "leg_axial_damping", "leg_bending_stiffness",
    "leg_bending_damping", "ground_stiffness", "ground_damping",
)  # fmt: skip

# Names that `continuous_law` binds to the formulas of a law.
friction: Compiled = None  # type: ignore[assignment]
damping: Compiled = None  # type: ignore[assignment]


@dataclass(frozen=True, eq=False)
class Surface:
    """A friction law and how it is identified.

    The first row that a law reads is the kinetic friction coefficient, the second the static one's excess
    where the law has one; a law with modes reads the front foot's excess third. `friction` belongs to a law
    without memory, `after_step` to one with modes; the other is None.
    """

    name: str  # word of campaigns, such as ``lf``
    # Rows of the gear's table, at most `LAW_SLOTS`, in the order in which its functions receive the tuple
    # ``law``.
    reads: tuple[str, ...]
    free: tuple[str, ...]  # parameters that a fit searches by default
    # ``(joints, angles, rates, loads, normals, slips, modes, law, coefficients) -> (accelerations, friction,
    # required, stiff)``: the motion's seven accelerations under the law, friction on the rear and front foot
    # [N], the friction that each foot would need to stick [N], and the fastest decay rate of a slip [1/s],
    # which bounds the explicit step. Arguments as in `sysid.gear.kernel.dynamics`; ``modes`` is (stuck,
    # stuck, way, way) of the rear and front foot. `continuous_law` makes it from two formulas.
    solve: Compiled
    # ``(work, lane, lanes, h, taken, new_h) -> (taken, new_h)``: decide on a step, and switch the modes
    # (`sysid.gear.surfaces.high_friction`).
    after_step: Compiled | None = None
    # ``(force_c, force_d, slip_c, slip_d, law) -> (friction_c, friction_d)``.
    friction: Compiled | None = None
    # Default values, whose `source` is stated, and search bounds where they differ from the table's [SI].
    nominal: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # Bound of the weighted rms error of the seven rates per step that a fit needs on this surface.
    tolerance: float = 3e-4
    budget: float = 4.5e4  # right-hand sides that a drop may spend per second at that tolerance
    source: str = ""
    title: str = ""  # words of a report in "the ... law", the name by default

    def __post_init__(self) -> None:
        if not 1 <= len(self.reads) <= LAW_SLOTS:
            raise ValueError(f"surface {self.name}: reads {len(self.reads)} parameters, 1 to {LAW_SLOTS} fit")
        if (self.after_step is None) == (self.friction is None):
            raise ValueError(
                f"surface {self.name}: give `friction` for a law without memory or `after_step` for one with"
            )

    @property
    def switching(self) -> bool:
        """Whether feet have modes that switch."""
        return self.after_step is not None


def specialized(function: Callable[..., object], **bindings: object) -> types.FunctionType:
    """Return a copy of a Python function that sees other functions under the given global names.

    The way one text serves every surface: numba inlines what the names are bound to.
    """
    copy = types.FunctionType(
        function.__code__,
        {**function.__globals__, **bindings},
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    copy.__qualname__ = function.__qualname__
    copy.__module__ = function.__module__
    return copy


def law_text(surface: Surface) -> bytes:
    """Return bytes that change with a law: its file, or its code where it was typed in a session."""
    law = surface.friction if surface.friction is not None else surface.solve
    file = Path(inspect.getfile(getattr(law, "py_func", law)))
    if file.is_file():
        return file.read_bytes()
    texts: dict[object, bytes] = {}
    for function in (surface.friction, surface.solve, surface.after_step):
        _collect(function, texts)
    return b"".join(texts.values())


def _collect(called: object, texts: dict[object, bytes]) -> None:
    """Add the code, constants and called functions of a function, each once."""
    function = getattr(called, "py_func", called)
    if function in texts or not isinstance(function, types.FunctionType):
        return
    texts[function] = b""
    code, text = [function.__code__], b""
    seen = {**function.__globals__, **inspect.getclosurevars(function).nonlocals}
    for part in code:
        code += [inner for inner in part.co_consts if isinstance(inner, types.CodeType)]
        plain = [repr(value) for value in part.co_consts if not isinstance(value, types.CodeType)]
        text += part.co_code + repr((plain, part.co_names, part.co_varnames, part.co_freevars)).encode()
        for name in (*part.co_names, *part.co_freevars):
            value = seen.get(name)
            if isinstance(value, bool | int | float | tuple):
                text += f"{name}={value!r}".encode()
            elif callable(value):
                _collect(value, texts)
    texts[function] = text


def continuous_law(friction: Compiled, damping: Compiled) -> Compiled:
    """Make a `Surface.solve` from the compiled formula of a friction that is a function of force and slip.

    `friction` is as in `Surface`; `damping` is ``(force, slip, law) -> -dF_t/dv`` [N·s/m], 0 or more.
    """
    return fused(specialized(_solve, friction=friction, damping=damping))


def _solve(joints, angles, rates, loads, normals, slips, modes, law, coefficients):
    _, h_c, _, h_d, _ = angles
    n_c, n_d = normals
    v_c, v_d = slips
    f_c, f_d = friction(n_c, n_d, v_c, v_d, law)
    loose_c, loose_d = foot_looseness(joints, h_c, h_d, coefficients)
    stiff_c = loose_c * damping(n_c, v_c, law)
    stiff_d = loose_d * damping(n_d, v_d, law)
    acceleration = accelerations(joints, angles, rates, loads, normals, f_c, f_d, coefficients)
    return acceleration, (f_c, f_d), (0.0, 0.0), stiff_c if stiff_c > stiff_d else stiff_d
