"""Reads mapping files, with errors that name file, line and key."""

from handover_ros.mapping.document import InvalidMapping, load, parse
from handover_ros.mapping.model import Mapping

__all__ = ["InvalidMapping", "Mapping", "load", "parse"]
