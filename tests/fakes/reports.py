"""Fits of the samples for reports."""

from fakes.places import SAMPLES
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions

# Searches that end at once: the pages do not depend on how good the numbers are.
SHORT = {"quiet": True, "runs": 2, "population": 16, "max_generations": 3, "finish": "none"}


def short_fits(folder):
    """Fit both gears and the motor of the samples; return the folders by name."""
    return {
        name: fit_campaign(SAMPLES / name / "campaign.toml", FitOptions(folder / name, **SHORT, trust=False))[
            1
        ]
        for name in ("gear-lf", "gear-hf", "motor")
    }
