"""Durations of ISO 8601: what is accepted, how long it is, and where the calendar ends."""

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.formats.durations import MAX_YEARS, Duration, add_months, parse_duration

MINUTE_US = 60 * 1_000_000


@pytest.mark.parametrize(
    ("text", "duration"),
    [
        ("PT5M", Duration(0, 5 * MINUTE_US)),
        ("P1Y2M", Duration(14, 0)),
        ("P1M", Duration(1, 0)),
        ("PT1M", Duration(0, MINUTE_US)),
        ("P2W", Duration(0, 14 * 24 * 60 * MINUTE_US)),
        ("P1DT12H", Duration(0, 36 * 60 * MINUTE_US)),
        ("PT0.25S", Duration(0, 250_000)),
        ("PT0,25S", Duration(0, 250_000)),
        ("PT0.1234567S", Duration(0, 123_456)),
        ("PT0S", Duration(0, 0)),
    ],
)
def test_a_duration_has_months_and_microseconds(text: str, duration: Duration) -> None:
    assert parse_duration(text) == duration


@pytest.mark.parametrize(
    "text", ["", "P", "PT", "P1DT", "P1H", "5M", "PT5", "PT-5S", "P1S", "PT5M ago", "pt5m", "PT٣S", " PT5M"]
)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="ISO 8601 duration"):
        parse_duration(text)


@pytest.mark.parametrize("text", [f"P{MAX_YEARS + 1}Y", "P999999999D", "PT999999999999H"])
def test_a_duration_beyond_the_calendar_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="calendar"):
        parse_duration(text)


@given(st.text("PT0123456789YMWDHS.,", max_size=40))
def test_any_text_is_parsed_or_refused(text: str) -> None:
    try:
        duration = parse_duration(text)
    except ValueError:
        return
    assert duration.months >= 0
    assert duration.microseconds >= 0


@given(st.integers(0, 999), st.integers(0, 999), st.integers(0, 999), st.integers(0, 999))
def test_parts_add_up(days: int, hours: int, minutes: int, seconds: int) -> None:
    length = timedelta(days=days, hours=hours, minutes=minutes, seconds=seconds)
    duration = parse_duration(f"P{days}DT{hours}H{minutes}M{seconds}S")
    assert timedelta(microseconds=duration.microseconds) == length
    assert duration.nominal_s == length.total_seconds()


def test_the_nominal_year_has_365_days_and_the_nominal_month_30() -> None:
    assert parse_duration("P1Y").nominal_s == 365 * 86_400
    assert parse_duration("P2M").nominal_s == 60 * 86_400


@given(st.datetimes(max_value=datetime(8999, 1, 1)), st.integers(0, 1200))  # noqa: DTZ001 - any calendar
def test_months_keep_the_day_or_use_the_last_of_the_month(moment: datetime, months: int) -> None:
    moved = add_months(moment, months)
    assert (moved.year * 12 + moved.month) - (moment.year * 12 + moment.month) == months
    assert moved.time() == moment.time()
    assert moved.day == moment.day or (moved.day < moment.day and (moved + timedelta(days=1)).day == 1)


def test_a_moment_after_the_year_9999_is_an_overflow() -> None:
    with pytest.raises(OverflowError):
        parse_duration("P1M").after(datetime(9999, 12, 1, tzinfo=UTC))
    with pytest.raises(OverflowError):
        parse_duration("P366D").after(datetime(9999, 1, 1, tzinfo=UTC))
