"""sysid: physical parameters of multirotor motors and landing gears from the logs of a lab."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid.export import load_parameter_sets as load_parameter_sets
    from sysid.parameter_sets import ParameterSets as ParameterSets

__version__ = "0.1.0"
__all__ = ["ParameterSets", "load_parameter_sets"]


def __getattr__(name: str) -> Any:
    # Imported on first use: `import sysid` stays light.
    if name == "load_parameter_sets":
        from sysid.export import load_parameter_sets

        return load_parameter_sets
    if name == "ParameterSets":
        from sysid.parameter_sets import ParameterSets

        return ParameterSets
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
