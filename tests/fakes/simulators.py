"""What another simulator reads from an exported model."""

import xml.etree.ElementTree as ElementTree


def from_mjcf(document):
    """Return the set [SI] that stands in a MuJoCo model."""
    rows = ElementTree.fromstring(document).iterfind("custom/numeric")
    return {row.get("name"): float(row.get("data")) for row in rows}


def from_sdf(document):
    """Return the numbers of the first rotor's plugin."""
    plugin = next(ElementTree.fromstring(document).iter("plugin"))
    keys = ("timeConstantUp", "timeConstantDown", "maxRotVelocity", "motorConstant", "momentConstant")
    return tuple(float(plugin.findtext(key)) for key in keys)
