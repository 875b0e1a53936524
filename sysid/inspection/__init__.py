"""What a recording holds and what looks wrong with it, before anything is fitted.

    from sysid.inspection import inspect_recording
    report = inspect_recording(load("drop.csv"))
    report.suspicions, report.drop, report.bench

Judges only what one recording shows; nothing is changed, and a suspicion is a sentence for a human to check.
"""

from sysid.inspection.bench import BenchReport
from sysid.inspection.channels import ChannelReport
from sysid.inspection.drop import DropReport
from sysid.inspection.whole import LogReport, inspect_recording

__all__ = ["BenchReport", "ChannelReport", "DropReport", "LogReport", "inspect_recording"]
