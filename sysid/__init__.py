"""sysid: physical parameters of multirotor motors and landing gears from the logs of a lab."""

__version__ = "0.1.0"
