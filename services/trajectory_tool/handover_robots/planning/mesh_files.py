"""Mesh files as shapes for coal, in m.

A URDF and a scene have lengths in m. STL and OBJ files have no unit, so their numbers are in m too, times
the `scale` of the reference. COLLADA files name their unit, which the library behind coal ignores: it is
applied here, before `scale`, as RViz and Gazebo do. Formats whose unit that library ignores as well, and
which robots rarely have, are refused.
"""

import re
from pathlib import Path
from typing import Any

import coal
import numpy as np
from lxml import etree

from handover.errors import UsageError
from handover_robots.planning.arm import Array

MAX_MESH_BYTES = 20 * 1024 * 1024
MAX_MESH_M, MIN_MESH_M = 20.0, 1e-3
"""The extent of a mesh. Beyond, its unit is nearly certainly another one."""
COLLADA = ".dae"
_OTHER_UNITS = frozenset({".3mf", ".amf", ".fbx", ".x3d"})


def load_mesh(file: Path, scale: Array) -> Any:
    """Return a mesh as a `coal.BVHModel` in m. Raises `UsageError`, which names the file."""
    suffix = file.suffix.lower()
    if suffix in _OTHER_UNITS:
        raise UsageError(
            f"the unit of the mesh {file} is not read; convert it to STL or OBJ in m, or to COLLADA"
        )
    try:
        if (size := file.stat().st_size) > MAX_MESH_BYTES:
            raise UsageError(
                f"the mesh {file} has {size >> 20} MB; reduce it to {MAX_MESH_BYTES >> 20} MB at most"
            )
        unit_m = _collada_unit_m(file) if suffix == COLLADA else 1.0
        mesh = coal.MeshLoader().load(str(file), np.asarray(scale, dtype=np.float64) * unit_m)
    except OSError as error:
        raise UsageError(f"the mesh {file} cannot be read: {error.strerror}") from None
    except (ValueError, RuntimeError) as error:
        raise UsageError(f"the mesh {file} cannot be read: {mesh_fault(error)}") from None
    _require_plausible(file, np.asarray(mesh.vertices(), dtype=np.float64).reshape(-1, 3))
    return mesh


def mesh_fault(error: Exception) -> str:
    """Return in one line what coal says about a mesh, without the place in its source."""
    said = re.search(r"^message: (.+)$", str(error), re.MULTILINE)
    return said[1] if said else str(error).partition("\n")[0]


def _collada_unit_m(file: Path) -> float:
    """Return the length of the unit of a COLLADA file in m; 1 is its default."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=False)
    try:
        root = etree.parse(str(file), parser).getroot()
    except etree.XMLSyntaxError as error:
        raise UsageError(f"the mesh {file} cannot be read: {error}") from None
    unit = root.find("{*}asset/{*}unit")
    written = "1" if unit is None else unit.get("meter", "1")
    try:
        unit_m = float(written)
    except ValueError:
        unit_m = np.nan
    if not 0 < unit_m < np.inf:
        raise UsageError(
            f'the mesh {file} has <unit meter="{written[:40]}"/>; give the length of its unit in m, above 0'
        )
    return unit_m


def _require_plausible(file: Path, points: Array) -> None:
    if not len(points) or not np.isfinite(points).all():
        raise UsageError(f"the mesh {file} has no corners, or some that are no numbers; export it again")
    extent_m = float(np.ptp(points, axis=0).max())
    if not MIN_MESH_M <= extent_m <= MAX_MESH_M:
        raise UsageError(
            f"the mesh {file} is {extent_m:g} m long; {MIN_MESH_M:g} to {MAX_MESH_M:g} m are plausible, so "
            'the unit seems to be another one: for mm give scale="0.001 0.001 0.001", or correct the <unit> '
            "of a COLLADA file"
        )
