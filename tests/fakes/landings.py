"""The published drone, its files, and the values of its gear."""

from fakes.places import PUBLISHED
from fakes.published import table_1, table_2
from sysid.gear.model import PARAMETERS, pack
from sysid.landing.drone import drones

LF, HF, MOTOR = (PUBLISHED / f"published-{name}.json" for name in ("gear-lf", "gear-hf", "motor"))


def published(surface="lf"):
    (drone,) = drones(table_2(surface), table_1())
    return drone


def values(surface, **changes):
    """Return the values of a published gear by name [SI]."""
    row = pack({k: v for k, v in table_2(surface).set_values(1).items() if k in PARAMETERS}, surface)
    return dict(zip(PARAMETERS, row.tolist(), strict=True)) | changes
