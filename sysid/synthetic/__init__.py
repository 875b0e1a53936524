"""Campaigns with known truth: simulated tests written in the log formats of real instruments.

A synthesized folder contains what a lab would have: a campaign file, and logs with noise, quantization, gaps,
tare, and different clocks and axes. Apart from these it contains ``truth.json`` with everything that a lab
would not know.
"""

from sysid.synthetic.folder import TRUTH_FILE, read_truth
from sysid.synthetic.gear import HF_DROPS, LF_DROPS, DropPlan, synthesize_gear
from sysid.synthetic.motor import synthesize_motor

__all__ = [
    "HF_DROPS",
    "LF_DROPS",
    "TRUTH_FILE",
    "DropPlan",
    "read_truth",
    "synthesize_gear",
    "synthesize_motor",
]
