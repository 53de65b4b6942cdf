"""Timers: a duration or a moment as BPMN writes them."""

from datetime import UTC, datetime

import pytest

from services.task_orchestrator.timers import due_at, read_moment

SINCE = datetime(2024, 1, 31, 12, 0, tzinfo=UTC)


@pytest.mark.parametrize(
    ("text", "moment"),
    [
        ("PT5S", datetime(2024, 1, 31, 12, 0, 5, tzinfo=UTC)),
        ("PT0.25S", datetime(2024, 1, 31, 12, 0, 0, 250_000, tzinfo=UTC)),
        ("PT1H30M", datetime(2024, 1, 31, 13, 30, tzinfo=UTC)),
        ("P1DT1M", datetime(2024, 2, 1, 12, 1, tzinfo=UTC)),
        ("P2W", datetime(2024, 2, 14, 12, 0, tzinfo=UTC)),
        ("P1M", datetime(2024, 2, 29, 12, 0, tzinfo=UTC)),
        ("P1Y", datetime(2025, 1, 31, 12, 0, tzinfo=UTC)),
        ("2024-02-01T08:00:00+02:00", datetime(2024, 2, 1, 6, 0, tzinfo=UTC)),
        ("2024-02-01T08:00:00Z", datetime(2024, 2, 1, 8, 0, tzinfo=UTC)),
    ],
)
def test_a_timer_is_due_at_its_time(text: str, moment: datetime) -> None:
    assert due_at(text, SINCE) == moment


@pytest.mark.parametrize("text", ["", "5M", "soon", "2024-13-01T08:00:00Z", "P", "PT5M ago", "pt5m"])
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r".+"):
        due_at(text, SINCE)


def test_a_moment_without_time_zone_is_refused() -> None:
    with pytest.raises(ValueError, match="time zone"):
        read_moment("2024-02-01T08:00:00")


def test_a_duration_beyond_the_calendar_is_refused() -> None:
    with pytest.raises(ValueError, match="year"):
        due_at("P999Y9999M999999D", datetime(9000, 1, 1, tzinfo=UTC))
