"""Resources are available from the time on when the cell was there."""

from datetime import UTC, datetime, timedelta

from handover_processes.allocation.agents import Agent
from handover_processes.reporting.views import resources_view
from handover_processes.tally import Period

NOW = datetime(2026, 11, 30, 12, tzinfo=UTC)
HOUR = int(NOW.timestamp()) // 3600
WEEK = Period(HOUR - 7 * 24, HOUR)
ROBOT = "urn:ngsi-ld:Device:demo:ur10-1"


def available_h(cell_begins: datetime | None) -> float:
    view = resources_view({ROBOT: 60_000}, {ROBOT: Agent(ROBOT)}, WEEK, NOW, cell_begins=cell_begins)
    return view["resources"][0]["availableMs"] / 3_600_000


def test_a_cell_of_half_an_hour_was_available_for_half_an_hour() -> None:
    assert available_h(NOW - timedelta(minutes=30)) == 0.5
    assert available_h(NOW - timedelta(days=30)) == 168
    assert available_h(None) == 168
