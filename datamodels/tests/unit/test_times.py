"""Moments keep the text they were written in, and are written in UTC."""

import copy
import pickle
from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_datamodels.times import Timestamp, as_written, iso, parse


@pytest.mark.parametrize(
    "text", ["2017-01-02T10:25:55.00Z", "2020-12-01T11:23:19Z", "2026-03-02T09:15:52.1181+02:00"]
)
def test_a_moment_that_is_passed_on_is_written_as_it_was_read(text: str) -> None:
    moment = parse(text)
    assert as_written(moment) == text
    assert as_written(copy.deepcopy(moment)) == text
    assert as_written(pickle.loads(pickle.dumps(moment))) == text


def test_moments_compare_by_time_whatever_their_text() -> None:
    assert parse("2026-01-01T10:00:00Z") == parse("2026-01-01T12:00:00.000+02:00")
    assert parse("2026-01-01T10:00:00Z") < datetime(2026, 1, 1, 10, 0, 1, tzinfo=UTC)


def test_a_moment_that_was_moved_forgets_the_old_text() -> None:
    moved = parse("2026-01-01T10:00:00Z") + timedelta(seconds=1)
    assert as_written(moved) == "2026-01-01T10:00:01.000000Z"
    assert as_written(copy.copy(moved)) == "2026-01-01T10:00:01.000000Z"


def test_iso_is_utc_with_a_fixed_number_of_decimals() -> None:
    moment = datetime(2026, 3, 2, 9, 15, 52, 118_400, tzinfo=timezone(timedelta(hours=2)))
    assert iso(moment) == "2026-03-02T07:15:52.118400Z"
    assert iso(moment, "milliseconds") == "2026-03-02T07:15:52.118Z"


@given(st.datetimes(timezones=st.just(UTC)), st.datetimes(timezones=st.just(UTC)))
def test_texts_of_moments_sort_like_the_moments(one: datetime, other: datetime) -> None:
    assert (iso(one) < iso(other)) == (one < other)
    assert parse(iso(one)) == one


@pytest.mark.parametrize("text", ["2026-01-01T10:00:00", "2026-01-01"])
def test_a_moment_without_a_time_zone_is_refused_with_the_way_out(text: str) -> None:
    with pytest.raises(ValueError, match="has no time zone; write UTC with a Z"):
        Timestamp.read(text)


@pytest.mark.parametrize("text", ["", "yesterday", "2026-13-01T00:00:00Z", "2026-01-01T25:00:00Z"])
def test_what_is_no_moment_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not a time; write it in ISO 8601"):
        parse(text)


def test_a_naive_moment_is_not_written() -> None:
    with pytest.raises(ValueError, match="has no time zone"):
        iso(datetime(2026, 1, 1))  # noqa: DTZ001 - the very thing that is refused
