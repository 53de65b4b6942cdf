"""Timers: moments, durations, repeating intervals and cron expressions."""

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_bpmn.timing.timers import MAX_CHARACTERS, Cycle, due_at, is_time, parse_cycle, read_moment

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


def _moments(cycle: Cycle, since: datetime, limit: int = 5) -> list[datetime]:
    """Return the moments of `cycle`, at most `limit`."""
    moments = [cycle.first(since)]
    while len(moments) < limit and (following := cycle.next(moments[-1], len(moments))) is not None:
        moments.append(following)
    return moments


@pytest.mark.parametrize(
    ("text", "moments"),
    [
        ("R3/PT1M", ["12:01", "12:02", "12:03"]),
        ("R2/2024-01-31T13:00:00Z/PT1H", ["13:00", "14:00"]),
        ("R3/2024-01-31T11:30:00Z/PT1H", ["12:30", "13:30"]),
        ("R3/2024-01-31T14:00:00+02:00/PT1H", ["12:00", "13:00", "14:00"]),
        ("R9/PT1M/2024-01-31T12:02:30Z", ["12:01", "12:02"]),
        ("R2/2024-01-31T13:00:00Z/2024-01-31T13:20:00Z", ["13:00", "13:20"]),
        ("R3/PT0S", ["12:00", "12:00", "12:00"]),
        ("R2/PT0.001S", ["12:00", "12:00"]),
        ("R3/2024-01-31T13:00:00Z/PT0S", ["13:00", "13:00", "13:00"]),
    ],
)
def test_a_repeating_interval_ends_after_its_repetitions(text: str, moments: list[str]) -> None:
    assert [f"{moment:%H:%M}" for moment in _moments(parse_cycle(text), SINCE, 20)] == moments


@pytest.mark.parametrize(
    ("text", "moments"),
    [
        ("R/PT90S", ["31 12:01:30", "31 12:03:00"]),
        ("R-1/PT1H", ["31 13:00:00", "31 14:00:00"]),
        ("*/5 * * * *", ["31 12:05:00", "31 12:10:00"]),
        ("0/5 0/1 * 1/1 * ?", ["31 12:00:05", "31 12:00:10"]),
        ("30 0/20 9-12 * * MON-FRI", ["31 12:00:30", "31 12:20:30"]),
        ("00-0 13 3-3 * *", ["03 13:00:00", "03 13:00:00"]),
        ("0 0 * * 5", ["02 00:00:00", "09 00:00:00"]),
        ("0 0 0 ? * 6", ["02 00:00:00", "09 00:00:00"]),
        ("0 0 0 * * 5", ["02 00:00:00", "09 00:00:00"]),
        ("0 0 * * 5-7", ["02 00:00:00", "03 00:00:00"]),
        ("0 0 * * SAT-MON", ["03 00:00:00", "04 00:00:00"]),
        ("0 0 1 * 5", ["01 00:00:00", "02 00:00:00"]),
        ("0 0 0 2 * FRI", ["02 00:00:00", "02 00:00:00"]),
        ("0 0 12 L * ?", ["29 12:00:00", "31 12:00:00"]),
        ("0 0 12 ? * 6L", ["23 12:00:00", "29 12:00:00"]),
        ("0 0 12 ? * FRI#1", ["02 12:00:00", "01 12:00:00"]),
        ("0 0 12 ? * L", ["03 12:00:00", "10 12:00:00"]),
        ("@hourly", ["31 13:00:00", "31 14:00:00"]),
        ("@daily", ["01 00:00:00", "02 00:00:00"]),
        ("TZ=Europe/Berlin 0 8 * * *", ["01 07:00:00", "02 07:00:00"]),
        ("0 0 0 1 1 ? 2030", ["01 00:00:00"]),
    ],
)
def test_a_cycle_is_due_at_its_moments(text: str, moments: list[str]) -> None:
    assert [f"{moment:%d %H:%M:%S}" for moment in _moments(parse_cycle(text), SINCE, 2)] == moments


def test_a_monthly_cycle_with_a_start_keeps_the_day_of_the_month() -> None:
    cycle = parse_cycle("R4/2024-01-31T12:00:00Z/P1M")
    assert [f"{moment:%m-%d}" for moment in _moments(cycle, SINCE)] == ["01-31", "02-29", "03-31", "04-30"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "5 to 7 fields"),
        ("PT1M", "write R3/PT1M"),
        ("R3", "5 to 7 fields"),
        ("R3/", "no ISO 8601 duration"),
        ("R0/PT1M", "1 to 1000000 times"),
        ("R9999999/PT1M", "1 to 1000000 times"),
        ("R/PT0S", "less than 10 ms"),
        ("R/PT0.001S", "less than 10 ms"),
        ("R3/2024-01-31T12:00:00/PT1M", "time zone"),
        ("R1001/PT0S", "1000 times at most"),
        ("R3/2024-02-01T12:00:00Z/2024-01-01T12:00:00Z", "ends before it begins"),
        ("R3/PT1M/PT1M", "is no moment"),
        ("R3/a/b/c", "no cycle"),
        ("* * * *", "5 to 7 fields"),
        ("* * * * * * * *", "5 to 7 fields"),
        ("60 * * * *", "out of range"),
        ("*/0 * * * *", "step"),
        ("H * * * *", "5 to 7 fields"),
        ("0 H * * *", '"H" cannot stand in field 2'),
        ("0 R(1-5) * * *", "5 to 7 fields"),
        ("0 0 * MON *", '"MON" cannot stand in field 4'),
        ("? * * * *", "`?` can only stand"),
        ("0 0 * * 8", "not 8"),
        ("0 0 0 ? * 0", "1 (Sunday) to 7 (Saturday), not 0"),
        ("@reboot", "5 to 7 fields"),
        ("TZ=Nowhere/Town 0 8 * * *", "no time zone"),
        ("TZ=../../etc/passwd 0 8 * * *", "no time zone"),
        ("*" * (MAX_CHARACTERS + 1), "at most 200 characters"),
    ],
)
def test_a_text_that_is_no_cycle_is_refused_with_a_reason(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=r".+") as refusal:
        parse_cycle(text)
    assert reason in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("R3/2024-01-01T12:00:00Z/PT1M", "repetitions since 2024-01-01T12:00:00"),
        ("R3/PT1H/2024-01-31T12:30:00Z", "before it is due"),
        ("R/P9000Y", "9999"),
        ("0 0 30 2 *", "no moment"),
        ("0 0 0 1 1 ? 2020", "no moment"),
    ],
)
def test_a_cycle_that_is_never_due_is_refused_at_its_start(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parse_cycle(text).first(SINCE)


@pytest.mark.parametrize("text", ["R/PT10S", "R/2020-01-01T00:00:00Z/P1M", "*/10 * * * * *", "R/P1M"])
def test_a_cycle_skips_a_long_time_in_one_step(text: str) -> None:
    cycle, now = parse_cycle(text), datetime(2124, 6, 15, 12, 0, 5, tzinfo=UTC)
    due = cycle.next_after(cycle.first(SINCE), now)
    assert due is not None
    assert due > now
    assert due - now <= timedelta(days=31)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("PT5M", True),
        ("2026-05-01T08:00:00Z", True),
        ("R3/PT1M", True),
        ("R/2026-05-01T08:00:00Z/PT1M", True),
        ("0/5 0/1 * 1/1 * ?", True),
        ("*/5 * * * MON-FRI", True),
        ("@daily", True),
        ("TZ=Europe/Berlin 0 8 * * *", True),
        ("wait", False),
        ("order.due", False),
        ("R / PT", False),
        ("a * b * c", False),
        ("'PT' + minutes", False),
    ],
)
def test_a_time_is_not_taken_for_an_expression(text: str, expected: bool) -> None:
    assert is_time(text) is expected


FIELDS = st.sampled_from(
    ["*", "?", "0", "5", "*/7", "3/4", "1-5", "1,3,5", "0-0", "L", "MON", "6#2", "15W", "JAN", "9L", "2030"]
)
CRON = st.lists(FIELDS, min_size=4, max_size=7).map(" ".join)
INTERVALS = st.builds(
    "R{}/{}{}".format,
    st.sampled_from(["", "2", "3"]),
    st.sampled_from(["", "2024-01-01T00:00:00Z/"]),
    st.sampled_from(["PT1M", "P1M", "P1Y2M3DT4H", "PT0.5S"]),
)
LOCAL_CRON = st.builds(
    "TZ={} {} {} * * *".format,
    st.sampled_from(["Europe/Berlin", "Australia/Lord_Howe"]),
    st.sampled_from(["*/15", "30", "0"]),
    st.sampled_from(["*", "2", "1-3"]),
)
CYCLES = CRON | INTERVALS | LOCAL_CRON | st.text(max_size=20)
MOMENTS = st.integers(6 * 10**8, 3 * 10**9).map(lambda seconds: datetime.fromtimestamp(seconds, UTC))


@given(CYCLES, MOMENTS)
def test_the_moments_of_a_cycle_grow_and_end_with_its_count(text: str, since: datetime) -> None:
    try:
        cycle = parse_cycle(text)
        moments = _moments(cycle, since, 4)
    except ValueError:
        return
    assert all(earlier < later for earlier, later in zip([since, *moments], moments, strict=False)) or (
        moments[0] == since and text.startswith("R")
    )
    if text.startswith(("R2", "R3")):
        assert len(moments) <= int(text[1])
    following = cycle.next_after(moments[0], since)
    assert following is None or following > since


@given(st.text(max_size=20) | CYCLES, MOMENTS)
def test_any_text_is_a_time_or_a_value_error(text: str, since: datetime) -> None:
    try:
        assert due_at(text, since).tzinfo is not None
    except ValueError:
        return
