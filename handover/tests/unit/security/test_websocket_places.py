"""Places for WebSockets: what one person opens leaves room for others, and for control in any case."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover.security.caller import LOCAL_OWNER, Caller, CallerKind
from handover.security.permissions import Permission
from handover.security.websocket_places import WebSocketPlaces
from handover.settings import Settings

SETTINGS = Settings.load(
    _env_file=None,
    http_max_websockets=40,
    http_max_websockets_per_session=5,
    http_max_websockets_per_person=8,
)
SERVICE = Caller(CallerKind.SERVICE, "s", "webui")


def person(name: str, session: str = "1") -> Caller:
    return Caller(CallerKind.USER, name, name, session=f"{name}-{session}")


def opened(places: WebSocketPlaces, caller: Caller, permission: Permission, count: int) -> list[Any]:
    """Open until one is refused, at most `count`."""
    scopes: list[Any] = []
    for _ in range(count):
        scope: dict[str, Any] = {}
        try:
            places.take(caller, permission, scope)
        except Problem:
            break
        scopes.append(scope)
    return scopes


def test_a_session_and_a_person_have_limits_of_their_own() -> None:
    places = WebSocketPlaces(SETTINGS)
    first = opened(places, person("vera"), Permission.READ, 100)
    assert len(first) == 5
    assert len(opened(places, person("vera", "2"), Permission.READ, 100)) == 3
    assert len(opened(places, person("otto"), Permission.READ, 1)) == 1
    places.free(first[0])
    places.free(first[0])
    assert len(opened(places, person("vera", "3"), Permission.READ, 100)) == 1


@pytest.mark.parametrize("crowd", [LOCAL_OWNER, person("vera")])
def test_control_and_services_find_a_place_however_many_read(crowd: Caller) -> None:
    places = WebSocketPlaces(SETTINGS)
    readers = opened(places, LOCAL_OWNER, Permission.READ, 100)
    assert len(readers) == 36
    assert opened(places, crowd, Permission.READ, 1) == []
    assert len(opened(places, person("otto"), Permission.MOVE_ROBOTS, 2)) == 2
    assert len(opened(places, SERVICE, Permission.READ_HEALTH_DATA, 2)) == 2


@given(st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from("12"), st.booleans()), max_size=80))
def test_places_are_freed_as_they_were_taken(acts: list[tuple[str, str, bool]]) -> None:
    places = WebSocketPlaces(SETTINGS)
    scopes: list[Any] = []
    for name, session, moves in acts:
        permission = Permission.MOVE_ROBOTS if moves else Permission.READ
        scopes += opened(places, person(name, session), permission, 2)
    for scope in scopes:
        places.free(scope)
    assert len(opened(places, LOCAL_OWNER, Permission.READ, 100)) == 36
    assert len(opened(places, person("a"), Permission.READ, 100)) == 0
