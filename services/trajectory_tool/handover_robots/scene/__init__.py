"""The scene of a cell: what stands in it, the parts that lie in it, and what a camera sees of them."""

from handover_robots.scene.reading import load, read_scene
from handover_robots.scene.scene import Scene

__all__ = ["Scene", "load", "read_scene"]
