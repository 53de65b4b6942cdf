"""Reads mapping files, with errors that name file, line and key."""

from ros_fiware_bridge.mapping.document import InvalidMapping, load, parse
from ros_fiware_bridge.mapping.model import Mapping

__all__ = ["InvalidMapping", "Mapping", "load", "parse"]
