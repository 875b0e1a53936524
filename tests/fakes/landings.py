"""The published drone, and readers of the files of maps and design studies."""

from sysid.export.published import table_1, table_2
from sysid.landing.design_study import Change, DesignStudy, StudySettings
from sysid.landing.drone import drones
from sysid.landing.impulse_maps import UNITS, ImpulseMap
from sysid.landing.maps import LandingMap, MapSettings
from sysid.landing.outcomes import Rules
from sysid.landing.store import MAPS, STUDY, MapFile
from sysid.storage import get_json, get_texts, numbered


def published(surface="lf"):
    (drone,) = drones(table_2(surface), table_1())
    return drone


def read_maps(path):
    """Return the content of a file of maps."""
    with MAPS.opened(path) as file:
        settings, provenance = (get_json(file, f"{name}_json") for name in ("settings", "provenance"))
        maps = tuple(map(_landings, numbered(file, "maps")))
        return MapFile(maps, tuple(map(_impulses, numbered(file, "impulses"))), settings, provenance)


def _head(group):
    words = (str(group.attrs["surface"]), str(group.attrs["controller"]), tuple(get_texts(group, "sets")))
    return *words, group["slope"][()], group["speed"][()]


def _landings(group):
    arrays = [group[name][()] for name in ("outcome", "distance", "time")]
    checked = bool(group.attrs["checked"])
    uncertain = group["uncertain"][()] if checked else arrays[0] < 0
    return LandingMap(*_head(group), *arrays, uncertain, checked=checked)


def _impulses(group):
    return ImpulseMap(*_head(group), {name: group[name][()] for name in UNITS})


def read_study(path):
    """Return a design study and its provenance."""
    with STUDY.opened(path) as file:
        document, provenance = (get_json(file, f"{name}_json") for name in ("settings", "provenance"))
        maps = MapSettings(rules=Rules(**document["rules"]), tolerance=document["tolerance"], check=False)
        axes = (tuple(file[name][()].tolist()) for name in ("slope", "speed"))
        more = (document[name] for name in ("share", "spread_deg", "together"))
        changes = tuple(Change(**row | {"values": tuple(row["values"])}) for row in document["changes"])
        arrays = (file[name][()] for name in ("designs", "landed", "lost"))
        names = (str(file.attrs[name]) for name in ("name", "controller"))
        return DesignStudy(*names, changes, StudySettings(*axes, *more, maps), *arrays), provenance
