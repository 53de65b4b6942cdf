"""Roles and grants: what they allow, and for which resources."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import UsageError
from handover.security.caller import LOCAL_OWNER, Caller, CallerKind
from handover.security.permissions import (
    Grant,
    Permission,
    Role,
    is_allowed,
    is_allowed_somewhere,
)
from handover.security.resource_patterns import MAX_STARS, is_match, require_pattern

UR10 = "urn:ngsi-ld:Device:demo:ur10-1"
ids = st.text(st.characters(codec="ascii", categories=("L", "N"), include_characters=":-."), min_size=1)


@given(ids)
def test_an_id_without_a_star_includes_itself_only(resource: str) -> None:
    assert is_match(resource, resource)
    assert not is_match(resource, f"{resource}x")
    assert not is_match(resource, "*")


@given(ids, ids, ids)
def test_a_star_stands_for_any_characters(start: str, middle: str, end: str) -> None:
    assert is_match(f"{start}*{end}", f"{start}{middle}{end}")
    assert not is_match(f"{start}*{end}", f"_{start}{middle}{end}")
    assert not is_match(f"{start}*{end}", f"{start}{middle}{end}_")


@pytest.mark.parametrize("pattern", ["", "two words", "a" * 301, "*" * (MAX_STARS + 1), "a\nb"])
def test_an_invalid_pattern_is_refused(pattern: str) -> None:
    with pytest.raises(UsageError):
        require_pattern(pattern)


def test_a_grant_for_one_robot_moves_no_other_and_not_everything() -> None:
    grants = [Grant(Role.ENGINEER, UR10)]
    assert is_allowed(grants, Permission.MOVE_ROBOTS, UR10)
    assert not is_allowed(grants, Permission.MOVE_ROBOTS, "urn:ngsi-ld:Device:demo:ur10-12")
    assert not is_allowed(grants, Permission.MOVE_ROBOTS)
    assert is_allowed_somewhere(grants, Permission.MOVE_ROBOTS)


@pytest.mark.parametrize(
    ("role", "permission"),
    [
        (Role.VIEWER, Permission.PERFORM_TASKS),
        (Role.OPERATOR, Permission.MOVE_ROBOTS),
        (Role.OPERATOR, Permission.RUN_PROCESSES),
        (Role.ENGINEER, Permission.MANAGE_PEOPLE),
        (Role.ENGINEER, Permission.READ_STUDIES),
        (Role.ENGINEER, Permission.READ_HEALTH_DATA),
        (Role.RESEARCHER, Permission.MOVE_ROBOTS),
        (Role.ADMIN, Permission.MOVE_ROBOTS),
        (Role.ADMIN, Permission.READ_HEALTH_DATA),
        (Role.SERVICE, Permission.MANAGE_PEOPLE),
    ],
)
def test_no_role_has_the_permissions_of_another(role: Role, permission: Permission) -> None:
    assert not is_allowed([Grant(role)], permission)


def test_everybody_with_a_role_may_see_the_cell_and_the_owner_may_do_everything() -> None:
    assert all(Permission.READ in role.permissions for role in Role)
    assert {permission for permission in Permission if not LOCAL_OWNER.may(permission)} == {
        Permission.VERIFY_CALLERS,
        Permission.PERFORM_FOR_DEVICES,
    }, "what only services and components do"


def test_nobody_without_a_grant_may_do_anything() -> None:
    assert not any(is_allowed_somewhere([], permission) for permission in Permission)


def test_a_person_who_is_signed_in_acts_under_the_own_name() -> None:
    anna = Caller(CallerKind.USER, "subject-1", "Anna")
    assert anna.acting_name("Ben") == "Anna"
    assert Caller(CallerKind.SCRIPT, "subject-2", "nightly").acting_name("Ben") == "nightly"
    assert LOCAL_OWNER.acting_name(" Ben ") == "Ben"
    assert Caller(CallerKind.SERVICE, "subject-3", "gesture-controller").acting_name("Ben") == "Ben"
