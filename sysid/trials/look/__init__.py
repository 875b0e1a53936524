"""What a recording holds and what looks wrong with it, before anything is fitted.

    from sysid.trials.look import inspect_recording
    report = inspect_recording(load("drop.csv"))
    report.suspicions, report.drop, report.bench

Judges only what one recording shows; nothing is changed, and a suspicion is a sentence for a human to check.
"""

from sysid.trials.look.bench import BenchReport
from sysid.trials.look.channels import ChannelReport
from sysid.trials.look.drop import DropReport
from sysid.trials.look.whole import LogReport, inspect_recording, log_quality

__all__ = ["BenchReport", "ChannelReport", "DropReport", "LogReport", "inspect_recording", "log_quality"]
