"""What sysid says when an input or a request cannot be used.

Every message is one sentence that names what, where, what was found, what was expected and the next step.
The command line prints it on one line and exits with 2.
"""


class SysidError(Exception):
    """Base of every refusal that sysid makes on purpose."""


class LogError(SysidError):
    """A log file cannot be read, or lacks what the campaign says is in it."""


class CampaignError(SysidError):
    """A campaign file is malformed, incomplete or contradicts itself."""


class CampaignFileError(CampaignError):
    """A campaign cannot be used; the message begins with the path of its file."""


class UnitError(SysidError):
    """A quantity has no unit, an unknown unit or a unit of the wrong dimension."""


class FitError(SysidError):
    """A fit cannot start, continue or be written."""


class ExportError(SysidError):
    """A parameter-set file cannot be written or read."""


class SysidWarning(UserWarning):
    """A result is usable but something about it should be known; printed as one sentence."""
