"""Status, lifetime and validation of snapshots."""

from datetime import UTC, datetime
from typing import Any

import pytest

from handover.errors import Problem
from handover_broker.model.entity import Entity
from handover_broker.model.validation import inside, moment, outside, tenant_headers
from handover_federation.snapshots.content import SnapshotContent
from handover_federation.snapshots.snapshot import (
    MAX_LIFETIME_S,
    Status,
    details,
    expiry_of,
    new_snapshot,
    require_valid,
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
def test_the_status_of_a_snapshot_follows_its_queries(queries: list[str], snapshot: str) -> None:
    assert status_of([details(Status(one)) for one in queries]) == snapshot


@pytest.mark.parametrize(
    ("wanted", "lasts_s"), [("PT1H", 3600.0), ("PT0S", 1.0), ("P100Y", MAX_LIFETIME_S), (None, 86400.0)]
)
def test_the_lifetime_of_a_snapshot_is_limited(wanted: str | None, lasts_s: float) -> None:
    start = datetime(2026, 1, 1, tzinfo=UTC)
    assert (moment(expiry_of(start, wanted)) or 0.0) - start.timestamp() == lasts_s


def test_a_failed_snapshot_has_the_reason_at_each_query() -> None:
    made = new_snapshot("urn:x:1", require_valid({"snapshotQueries": [QUERY, QUERY]}, has_queries=True))
    assert made.status is Status.PREPARING
    failed = restored("urn:x:1", made.failed(Problem(500, "Internal error", "no luck")).stored())
    assert failed.status is Status.FAILURE
    reasons = failed.document["snapshotQueriesDetails"]
    assert [one["resultStatus"] for one in reasons] == ["failure", "failure"]
    assert [one["problemDetails"]["detail"] for one in reasons] == ["no luck", "no luck"]
    assert "snapshotTemporalQueriesDetails" not in failed.document


def test_a_failed_query_adds_nothing() -> None:
    content, at = SnapshotContent(), "2026-01-01T00:00:00Z"
    one, other = (Entity(f"urn:x:{each}", ("urn:t",), {}, at, at) for each in (1, 2))
    content.add([one], None)
    content.add([one, other], None)
    content.keep_only(1)
    assert [each.id for each in content.entities] == [one.id]
    content.add([one, other], None)
    assert [each.id for each in content.entities] == [one.id, other.id]


@pytest.mark.parametrize("tenant", ["", "cell4"])
def test_the_tenant_of_a_snapshot_cannot_be_named_in_a_header(tenant: str) -> None:
    name = inside(tenant, "urn:x:1")
    assert outside(name) == (tenant, "urn:x:1")
    assert outside(tenant) == (tenant, None)
    document: list[Any] = [("NGSILD-Tenant", tenant)] if tenant else []
    assert tenant_headers(name) == [*document, ("NGSILD-Snapshot", "urn:x:1")]
    with pytest.raises(UnicodeEncodeError):  # headers are Latin-1
        name.encode("latin-1")


def test_members_set_by_the_broker_are_refused() -> None:
    with pytest.raises(Problem, match="set by the broker"):
        require_valid({"snapshotQueries": [QUERY], "snapshotStatus": "success"}, has_queries=True)
