"""URDF and SRDF files of strangers: read without entities and network, and checked to be one tree.

Meshes are named relative to the file or by `package://`. With an address or a path of the machine, a program
that draws the robot would read what the author of the file wants.
"""

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

from lxml import etree

from handover.errors import UsageError

_PACKAGE = "package://"
_XACRO_DEFINITIONS = frozenset({"property", "macro", "arg"})
_XACRO_VALUE = re.compile(r"\$[{(]")
SIZES = ("radius", "length", "size")
PLACEHOLDER_M, THIN_M = 1e-3, 1e-3
"""A shape that is nowhere longer, and flat, is a placeholder; another flat one gets this thickness."""
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")


def parse_robot_xml(text: str, what: str) -> Any:
    """Return the root element of a URDF or SRDF, which is called `what`. Raises `UsageError`."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True, huge_tree=False)
    try:
        root = etree.fromstring(text.encode(), parser)
    except etree.XMLSyntaxError as error:
        raise UsageError(f"the {what} is not XML: {error}") from None
    remove_namespace(root)
    if not _drop_unused_xacro(root):
        raise UsageError(f"the {what} is a xacro file; expand it first: xacro FILE.xacro > FILE.urdf")
    if root.tag != "robot":
        hint = "; convert the SDF to a URDF first" if root.tag == "sdf" else ""
        raise UsageError(f"the root element of the {what} is <{root.tag}>, not <robot>{hint}")
    return root


def remove_namespace(root: Any) -> None:
    """Remove the namespace of the root from all elements that have it: readers of URDFs know none."""
    if not str(root.tag).startswith("{"):
        return
    namespace = root.tag.partition("}")[0] + "}"
    if "xacro" in namespace:
        return
    for element in root.iter(f"{namespace}*"):
        element.tag = element.tag.removeprefix(namespace)
    etree.cleanup_namespaces(root)


def _drop_unused_xacro(root: Any) -> bool:
    """Remove definitions of xacro that nothing uses; return False if the file has to be expanded.

    Definitions alone do nothing. What uses them is an element of xacro, or `${…}` and `$(…)` in a value.
    """
    if _is_xacro(root):
        return False
    outermost = [tag for tag in root.iter("{*}*") if _is_xacro(tag) and not _is_within_xacro(tag)]
    for element in outermost:
        if etree.QName(element).localname not in _XACRO_DEFINITIONS:
            return False
        element.getparent().remove(element)
    values = (
        value for part in root.iter("link", "joint") for tag in part.iter("*") for value in tag.values()
    )
    return not outermost or not any(_XACRO_VALUE.search(value) for value in values)


def _is_within_xacro(element: Any) -> bool:
    return any(map(_is_xacro, element.iterancestors()))


def _is_xacro(element: Any) -> bool:
    return element.prefix == "xacro" or "xacro" in (etree.QName(element).namespace or "")


def number_of(element: Any, attribute: str) -> float | None:
    """Return an attribute as a number; None if it is missing, NaN if it is none."""
    written = None if element is None else element.get(attribute)
    if written is None:
        return None
    try:
        return float(written)
    except ValueError:
        return math.nan


def link_of(joint: Any, end: str) -> str:
    """Return the link at the `parent` or `child` end of a joint; empty without one."""
    element = joint.find(end)
    return "" if element is None else str(element.get("link") or "")


def settle_sizes(link: Any) -> list[str]:
    """Remove shapes without any extent, which are placeholders, thicken flat ones, and say so."""
    texts = []
    for shape in (*link.findall("collision"), *link.findall("visual")):
        sizes = {
            (plain, attribute): sizes_of(plain.get(attribute))
            for plain in plain_shapes(shape)
            for attribute in SIZES
            if plain.get(attribute) is not None
        }
        values = [value for size in sizes.values() for value in size]
        if 0.0 not in values or not all(value >= 0 for value in values):
            continue
        if max(values) <= PLACEHOLDER_M:
            link.remove(shape)
            texts.append(f"a {shape.tag} without any extent is left out")
        else:
            for (plain, attribute), size in sizes.items():
                plain.set(attribute, " ".join(f"{value or THIN_M:g}" for value in size))
            texts.append(f"a {shape.tag} has a size of 0; {THIN_M:g} m is used")
    return texts


def plain_shapes(shape: Any) -> list[Any]:
    """Return the shapes of a visual or collision that are no meshes."""
    geometry = shape.find("geometry")
    return [] if geometry is None else [tag for tag in geometry if tag.tag != "mesh"]


def sizes_of(written: str) -> list[float]:
    """Return the numbers of a size; NaN if they are none."""
    try:
        return [float(part) for part in written.split()] or [math.nan]
    except ValueError:
        return [math.nan]


def mesh_faults(root: Any) -> Iterator[str]:
    """Yield each mesh and texture of a URDF that is neither relative to it nor in a package."""
    for element in root.iter("mesh", "texture"):
        name = (element.get("filename") or "").strip()
        path = name.removeprefix(_PACKAGE)
        is_elsewhere = path.startswith(("/", "\\")) or ".." in re.split(r"[/\\]", path)
        if is_elsewhere or _SCHEME.match(path):
            yield (
                f'the {element.tag} "{name[:200]}" is outside of the robot; name it relative to the URDF, '
                "or by package://"
            )


def tree_faults(root: Any) -> Iterator[str]:
    """Yield why a URDF is no tree whose parts have names of their own, and no meshes from elsewhere."""
    yield from mesh_faults(root)
    links = [link.get("name") for link in root.findall("link")]
    joints = root.findall("joint")
    if not links:
        yield "there is no link"
        return
    for kind, names in (("link", links), ("joint", [joint.get("name") for joint in joints])):
        for name in sorted({str(name) for name in names if names.count(name) > 1}):
            yield f'two {kind}s are called "{name}"'
        if None in names or "" in names:
            yield f"a {kind} has no name"
    parents: dict[str, list[str]] = {}
    for joint in joints:
        ends = {end: link_of(joint, end) for end in ("parent", "child")}
        missing = [end for end, link in ends.items() if not link]
        if missing:
            yield f'the joint "{joint.get("name")}" has no {" and no ".join(missing)}'
            continue
        for end, link in ends.items():
            if link not in links:
                yield f'the {end} "{link}" of the joint "{joint.get("name")}" does not exist'
        parents.setdefault(ends["child"], []).append(ends["parent"])
    yield from _shape_faults(links, parents)


def loop_faults(root: Any) -> Iterator[str]:
    """Yield where the joints of a URDF close a loop, as far as their ends are named."""
    parents: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        parent, child = link_of(joint, "parent"), link_of(joint, "child")
        if parent and child:
            parents.setdefault(child, []).append(parent)
    yield from _loops(parents)


def _shape_faults(links: list[str], parents: Mapping[str, list[str]]) -> Iterator[str]:
    roots = [link for link in links if link not in parents]
    if not roots:
        yield "the joints form a loop without a root link; a robot description is a tree"
    if len(roots) > 1:
        yield f"there are {len(roots)} root links: {', '.join(roots)}; connect them by fixed joints"
    yield from _loops(parents)


def _loops(parents: Mapping[str, list[str]]) -> Iterator[str]:
    for child, above in parents.items():
        if len(above) > 1:
            yield f'the link "{child}" has {len(above)} parents, a closed loop; cut it: keep one joint'
    is_checked: set[str] = set()
    for start in parents:
        seen, link = {start}, start
        while link in parents and link not in is_checked:
            link = parents[link][0]
            if link in seen:
                yield f'the joints form a loop at "{link}"; a robot description is a tree'
                return
            seen.add(link)
        is_checked |= seen
