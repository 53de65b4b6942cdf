"""URDF files of strangers: a tree, with meshes that belong to the robot."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import UsageError
from handover.formats.robot_xml import loop_faults, mesh_faults, parse_robot_xml, tree_faults


def robot(edges: list[tuple[int, int]], mesh: str = "") -> str:
    links = sorted({link for edge in edges for link in edge} | {0})
    joints = (
        f'<joint name="j{number}" type="fixed"><parent link="{parent}"/><child link="{child}"/></joint>'
        for number, (parent, child) in enumerate(edges)
    )
    shape = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>' if mesh else ""
    named = (f'<link name="{link}">{shape if link == 0 else ""}</link>' for link in links)
    return f'<robot name="r">{"".join(named)}{"".join(joints)}</robot>'


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), max_size=8))
def test_joints_that_close_a_loop_are_found(edges: list[tuple[int, int]]) -> None:
    """A link is above itself, or has two parents."""
    children = [child for _, child in edges]
    reached = {link: {link} for link in range(6)}
    for _ in edges:
        for parent, child in edges:
            reached[parent] |= reached[child]
    is_loop = any(parent in reached[child] for parent, child in edges)
    root = parse_robot_xml(robot(edges), "URDF")
    assert bool(list(loop_faults(root))) == (is_loop or len(set(children)) < len(children))
    if is_loop:
        assert list(tree_faults(root))


@pytest.mark.parametrize(
    "mesh",
    [
        "file:///etc/passwd", "http://evil.example/a.stl", "HTTPS://evil.example/a.stl", "ftp://a/b.dae",
        "/etc/passwd", "../../secret.stl", "meshes/../../a.stl", "package://r/../../a.stl",
        "data:model/stl,x",
        "package://file:///etc/passwd", "C:\\a.stl", "\\\\server\\a.stl", " file:/a.stl",
    ],
)  # fmt: skip
def test_meshes_from_elsewhere_are_named(mesh: str) -> None:
    (fault,) = mesh_faults(parse_robot_xml(robot([(0, 1)], mesh), "URDF"))
    assert mesh.strip() in fault
    assert "package://" in fault


@pytest.mark.parametrize(
    "mesh", ["meshes/base.stl", "base..v2.stl", "package://ur_description/meshes/base.dae"]
)
def test_meshes_of_the_robot_are_accepted(mesh: str) -> None:
    assert list(tree_faults(parse_robot_xml(robot([(0, 1)], mesh), "URDF"))) == []


XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'


@pytest.mark.parametrize(
    "text",
    [
        f'<robot {XACRO}><link name="a"/></robot>',
        f'<robot {XACRO}><xacro:property name="p" value="${{1 + 1}}"/><link name="a"/></robot>',
        f'<robot {XACRO}><xacro:arg name="p" default="1"/><link name="a"/></robot>',
        f'<robot {XACRO}><xacro:macro name="m" params="x"><link name="${{x}}"/><xacro:if value="1"/>'
        '</xacro:macro><link name="a"/></robot>',
        '<robot xmlns="http://drake.mit.edu"><link name="a"/></robot>',
        '<robot xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"><link name="a"/></robot>',
    ],
)
def test_definitions_and_namespaces_that_nothing_uses_are_left_out(text: str) -> None:
    root = parse_robot_xml(text, "URDF")
    assert [part.tag for part in root] == ["link"]
    assert list(tree_faults(root)) == []


@pytest.mark.parametrize(
    "inner",
    [
        "<xacro:include filename='a.xacro'/>",
        "<xacro:m/>",
        "<link name='a'><xacro:property name='p' value='1'/><xacro:insert_block name='b'/></link>",
        "<xacro:property name='p' value='1'/><link name='${p}'/>",
        "<xacro:arg name='p' default='1'/><link name='a'><visual><mesh filename='$(arg p)'/></visual></link>",
    ],
)
def test_what_xacro_has_to_expand_is_refused(inner: str) -> None:
    with pytest.raises(UsageError, match="expand it first"):
        parse_robot_xml(f"<robot {XACRO}>{inner}</robot>", "URDF")
