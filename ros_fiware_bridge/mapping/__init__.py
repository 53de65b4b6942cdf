"""The mapping file: what an integrator writes, read with errors that name file, line and key."""

from ros_fiware_bridge.mapping.document import WrongMapping, load, parse
from ros_fiware_bridge.mapping.model import Mapping

__all__ = ["Mapping", "WrongMapping", "load", "parse"]
