"""The campaign file: what a lab measured, which logs it recorded, and how they are to be fitted.

TOML, validated whole before anything runs; every quantity carries its unit; an unknown key is an error that
names the nearest known one. `read_campaign` is the only door.
"""

from sysid.campaign.common import FitTable, ParameterChoices, TrialUse
from sysid.campaign.file import Campaign, read_campaign, register_campaign
from sysid.campaign.gear import GearCampaign, GearTrial
from sysid.campaign.motor import MotorCampaign, MotorTrial

__all__ = [
    "Campaign", "FitTable", "GearCampaign", "GearTrial", "MotorCampaign", "MotorTrial", "ParameterChoices",
    "TrialUse", "read_campaign", "register_campaign",
]  # fmt: skip
