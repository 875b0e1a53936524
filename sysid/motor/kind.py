"""Motors as a kind of model: how a bench is opened, fitted and followed up."""

from pathlib import Path

from sysid.campaign import MotorCampaign
from sysid.fit.kind import Kind, Term, Words
from sysid.motor.candidates import candidate_trials
from sysid.motor.follow_up import begin_fit, follow_up, numbers
from sysid.motor.known_values import motor_space, prepare_bench
from sysid.motor.model import PARAMETERS
from sysid.motor.problem import MotorProblem
from sysid.motor.simpler import simpler
from sysid.motor.story import MotorStory


def _open(campaign: MotorCampaign, path: Path, threads: int | None) -> MotorProblem:
    # Refused before the logs are read.
    campaign.parameters.measured_ranges(PARAMETERS)
    bench = prepare_bench(campaign, path)
    return MotorProblem.build(campaign, motor_space(campaign, bench), bench, bench.trials, threads)


MOTOR = Kind(
    name="motor",
    campaign=MotorCampaign,
    open=_open,
    begin=begin_fit,
    follow_up=follow_up,
    numbers=numbers,
    unmoved=lambda problem: problem.unmoved,
    candidates=candidate_trials,
    story=MotorStory,
    terms=(
        Term("supply sags", ("supply_resistance",)),
        Term("switches have a dead time", ("dead_time_voltage",)),
        Term("winding warms", ("winding_warming",)),
    ),
    simpler=simpler,
    words=Words(
        single="log of command steps",
        misleads="another supply, tare or state of the motor",
        unlike="another supply or tare, or a misread unit, clock or log",
    ),
)
