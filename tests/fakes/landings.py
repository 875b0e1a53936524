"""The published drone."""

from sysid.export.published import table_1, table_2
from sysid.landing.drone import drones


def published(surface="lf"):
    (drone,) = drones(table_2(surface), table_1())
    return drone
