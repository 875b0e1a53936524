"""Campaign of motor tests: ratings, command protocol, static logs, filter, cost, trials."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from sysid.campaign.common import (
    CampaignTable,
    CostTable,
    FitTable,
    Frequency,
    Measured,
    Time,
    TomlTable,
    TrialTable,
    Weights,
    stated_in,
)
from sysid.campaign.logs import BenchLogOptions, SecondLog, Unit
from sysid.stated import without_error
from sysid.types import CommandUnit, Direction, Rotation

Current = Annotated[float, stated_in("A"), Field(gt=0)]
AngularSpeed = Annotated[float, stated_in("rad/s"), Field(gt=0)]


def _unit_of_kv(value: object) -> object:
    text = without_error(str(value)).strip()
    if not isinstance(value, bool) and re.fullmatch(r"\+?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", text, re.IGNORECASE):
        raise ValueError(f'{text!r} has no unit; write kv = "{text} rpm/V", as motors are sold')
    return value


class MotorRatings(TomlTable):
    """`[motor]`: what the datasheet and a pendulum say."""

    kv: (
        Annotated[
            float, Field(gt=0), Measured("rad/s/V", "2 %", "speed without propeller over the supply"),
            BeforeValidator(_unit_of_kv),
        ]
        | None
    ) = None  # fmt: skip
    rotor_inertia: Annotated[float, Field(gt=0), Measured("kg·m²", "5 %", "trifilar pendulum")] | None = None
    reference_voltage: Annotated[float, Field(gt=0), Measured("V", "0.5 %", "multimeter")] | None = None
    saturation_current: Current | None = None
    saturation_speed: AngularSpeed | None = None


class CommandProtocol(TomlTable):
    """`[command]`: how a logged command becomes u in [-1, 1]."""

    unit: CommandUnit
    minimum: float | None = None
    maximum: float | None = None
    neutral: float | None = None
    forward_half: Literal["low", "high"] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> CommandProtocol:
        if self.forward_half is not None:
            if self.unit != "dshot":
                raise ValueError(f"forward_half belongs to unit = 'dshot', not to {self.unit!r}; drop it")
            stated = [n for n in ("minimum", "neutral", "maximum") if getattr(self, n) is not None]
            if stated:
                raise ValueError(
                    f"forward_half says what every DShot number means; drop {', '.join(stated)}, or drop it"
                )
            return self
        if self.minimum is None or self.maximum is None:
            missing = [n for n in ("minimum", "maximum") if getattr(self, n) is None]
            raise ValueError(
                f"{' and '.join(missing)} is missing; state the logged numbers of full reverse (or stop) and "
                "full forward, or forward_half = 'low' or 'high' for bidirectional DShot"
            )
        neutral = self.minimum if self.neutral is None else self.neutral
        if not self.minimum <= neutral < self.maximum:
            raise ValueError(
                f"minimum {self.minimum:g}, neutral {neutral:g}, maximum {self.maximum:g} are not in order"
            )
        return self


class StaticLog(TomlTable):
    """One entry of `curves.static` or `curves.no_load`."""

    log: str
    direction: Rotation = "forward"
    log_options: BenchLogOptions = BenchLogOptions()
    second_log: SecondLog | None = None


class Curves(TomlTable):
    """`[curves]`: logs of steady points; without any, the steady segments of the trials serve."""

    static: tuple[StaticLog, ...] = ()
    no_load: tuple[StaticLog, ...] = ()


class BenchLogs(BenchLogOptions):  # type: ignore[misc]
    """`[log]`: how the load-cell and thrust-stand files of the campaign are read."""

    command_unit: CommandUnit | None = None
    force_unit: Unit | None = None
    torque_unit: Unit | None = None
    speed_unit: Unit | None = None
    torque_sign: Literal["auto", "+", "-"] = "auto"
    thrust_sign: Literal["auto", "+", "-"] = "auto"
    current: Literal["supply", "motor"] = "supply"
    # Standard error of the calibration of the load cells, as a share; typical where nothing is stated.
    calibration_error: Annotated[float, stated_in("1"), Field(ge=0, lt=1)] = 0.01


class ChebyshevFilter(TomlTable):
    """`[filter]`: for logs fast enough; `auto` leaves slow logs unfiltered, with a note."""

    kind: Literal["auto", "chebyshev2", "none"] = "auto"
    stop_edge: Frequency = 100.0
    order: int = Field(default=10, ge=1, le=20)
    attenuation_db: float = Field(default=40.0, gt=0, lt=200)


class MotorWeights(Weights):
    """`[cost.weights]`."""

    torque: float = Field(default=1.0, ge=0)
    speed: float = Field(default=1.0, ge=0)


class MotorCost(CostTable):
    """`[cost]`: the NRMSE."""

    weights: MotorWeights = MotorWeights()


class MotorTrial(TrialTable):
    """One log of commands: which way it spins, and its window on the log's clock."""

    direction: Direction
    log_options: BenchLogOptions = BenchLogOptions()
    second_log: SecondLog | None = None
    start: Time | None = None
    end: Time | None = None


class MotorCampaign(CampaignTable):
    """Logs of one motor, propeller and speed controller."""

    kind: Literal["motor"]
    motor: MotorRatings = MotorRatings()
    command: CommandProtocol
    curves: Curves = Curves()
    log: BenchLogs = BenchLogs()
    filter: ChebyshevFilter = ChebyshevFilter()
    cost: MotorCost = MotorCost()
    fit: FitTable = FitTable()
    trials: tuple[MotorTrial, ...]

    @model_validator(mode="before")
    @classmethod
    def _every_log_has_a_delay(cls, data: Any) -> Any:
        # Earlier campaigns stated that, and could choose a common delay.
        if isinstance(data, dict) and data.get("nuisance") == {"command_delay": "log"}:
            data = {key: value for key, value in data.items() if key != "nuisance"}
        return data

    @model_validator(mode="after")
    def _bidirectional_needs_neutral(self) -> MotorCampaign:
        forward = all(trial.direction == "forward" for trial in self.trials)
        if not forward and self.command.neutral is None and self.command.forward_half is None:
            raise ValueError(
                "a reverse or reversal trial needs command.neutral, the command at rest, or "
                "command.forward_half of bidirectional DShot"
            )
        return self
