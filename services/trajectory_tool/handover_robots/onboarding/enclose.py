"""Makes the shapes of a robot of ours from the meshes of its manufacturer, and its SRDF from these.

    python -m handover_robots.onboarding.enclose ur5e --meshes ur5e_description/ur5e.urdf

The links that the URDF with the meshes has get shapes that enclose these meshes, in place of their present
ones; the others, such as a gripper, keep theirs.
"""

import argparse
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from handover_robots.model.srdf import Srdf
from handover_robots.onboarding.enclosure import mapped_surfaces
from handover_robots.onboarding.hulls import pieces_of
from handover_robots.onboarding.meshes import Surface
from handover_robots.onboarding.refinement import Shaping
from handover_robots.onboarding.semantics import write_pairs
from handover_robots.onboarding.urdf import Finding
from handover_robots.robots import ROBOTS

SAMPLES = 3000


def enclose(name: str, meshes: str) -> None:
    """Write the URDF and the SRDF of a robot in our tree. Raises `UsageError`."""
    folder = Path(str(resources.files("handover_robots.robots"))) / name
    urdf, srdf = folder / f"{name}.urdf", folder / f"{name}.srdf"
    model, findings = ROBOTS.load(name), list[Finding]()
    mapping, mapped = mapped_surfaces(model, meshes, findings)
    surfaces: dict[str, list[Surface]] = {}
    for link, place in mapping.places.items():
        surfaces.setdefault(place.link, []).extend(mapped[link])
    root = etree.fromstring(urdf.read_bytes())
    fingers = {finger.joint for finger in model.fingers}
    moved = {
        joint.find("child").get("link") for joint in root.findall("joint") if joint.get("name") in fingers
    }
    pieces = {}
    for link, of_link in surfaces.items():
        triangles = np.concatenate([surface.triangles for surface in of_link])
        # Between parts in a bin it counts how thin a finger is at its end.
        pieces[link] = pieces_of(triangles, 2, 1e-6) if link in moved else pieces_of(triangles)
    for link in root.findall("link"):
        if link.get("name") in pieces:
            for replaced in (*link.findall("collision"), *link.findall("collision_checking")):
                link.remove(replaced)
    shaping = Shaping(model, root, pieces, surfaces)
    excluded = shaping.settle(Srdf(), SAMPLES)
    shaping.arm(excluded)
    for link in root.findall("link"):
        for child in link if link.get("name") in pieces else ():
            child.tail = "\n  " if child.getnext() is None else "\n    "
    _rewrite(urdf, root)
    semantics = etree.fromstring(srdf.read_bytes())
    write_pairs(semantics, excluded)
    _rewrite(srdf, semantics)
    for finding in findings:
        print(f"{finding.level:<8} {finding.about}: {finding.text}")
    for link, reason in mapping.unmapped.items():
        print(f"warning  {link}: {reason}")
    print(f"{name}: " + ", ".join(f"{link} {len(of_link)}" for link, of_link in pieces.items()))


def _rewrite(path: Path, root: Any) -> None:
    """Write the root element of a file, and keep what stands before it."""
    head, start, _ = path.read_text(encoding="utf-8").partition("<robot")
    text = etree.tostring(root, encoding="unicode", with_tail=False).removeprefix(start)
    path.write_text(f"{head}{start}{text}\n", encoding="utf-8")


def main() -> None:
    """Enclose the meshes of one robot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", help="the robot, a folder of services/trajectory_tool/handover_robots/robots")
    parser.add_argument("--meshes", required=True, help="the URDF of the manufacturer, with its meshes")
    arguments = parser.parse_args()
    enclose(arguments.name, arguments.meshes)


if __name__ == "__main__":
    main()
