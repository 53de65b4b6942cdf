"""Snapshots: what becomes of one from what became of its queries, and how long it lasts."""

from datetime import UTC, datetime
from typing import Any

import pytest

from handover.errors import Problem
from services.context_broker.api.words import inside, moment, outside, tenant_headers
from services.context_broker.snapshots.snapshot import (
    LONGEST_LIFETIME_S,
    Status,
    checked,
    details,
    ending,
    new_snapshot,
    restored,
    status_of,
)

QUERY = {"type": "Query", "entities": [{"type": "Task"}]}


@pytest.mark.parametrize(
    ("queries", "snapshot"),
    [
        (["success", "success"], "success"),
        (["success", "empty"], "success"),
        (["empty", "empty"], "empty"),
        (["failure", "failure"], "failure"),
        (["success", "failure"], "partial"),
        (["empty", "failure"], "partial"),
        (["success", "partial"], "partial"),
    ],
)
def test_a_snapshot_is_as_good_as_its_queries(queries: list[str], snapshot: str) -> None:
    assert status_of([details(Status(one)) for one in queries]) == snapshot


@pytest.mark.parametrize(
    ("wanted", "lasts_s"), [("PT1H", 3600.0), ("PT0S", 1.0), ("P100Y", LONGEST_LIFETIME_S), (None, 86400.0)]
)
def test_a_snapshot_lasts_as_wished_within_bounds(wanted: str | None, lasts_s: float) -> None:
    start = datetime(2026, 1, 1, tzinfo=UTC)
    assert (moment(ending(start, wanted)) or 0.0) - start.timestamp() == lasts_s


def test_a_snapshot_that_was_being_made_when_the_broker_ended_has_failed() -> None:
    made = new_snapshot("urn:x:1", checked({"snapshotQueries": [QUERY]}, has_queries=True))
    assert made.status is Status.PREPARING
    assert restored(made.stored())["urn:x:1"].status is Status.FAILURE


@pytest.mark.parametrize("tenant", ["", "cell4"])
def test_what_belongs_to_a_snapshot_is_told_by_headers_and_named_by_none(tenant: str) -> None:
    name = inside(tenant, "urn:x:1")
    assert outside(name) == (tenant, "urn:x:1")
    assert outside(tenant) == (tenant, None)
    told: list[Any] = [("NGSILD-Tenant", tenant)] if tenant else []
    assert tenant_headers(name) == [*told, ("NGSILD-Snapshot", "urn:x:1")]
    with pytest.raises(UnicodeEncodeError):  # headers are Latin-1
        name.encode("latin-1")


def test_members_that_are_for_the_broker_to_say_are_refused() -> None:
    with pytest.raises(Problem, match="for the broker to say"):
        checked({"snapshotQueries": [QUERY], "snapshotStatus": "success"}, has_queries=True)
