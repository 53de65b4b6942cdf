"""Which messages about an Alert are due, and when."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_alerts.model.configuration import Hours, Route, read_configuration
from handover_alerts.model.occurrence import AlertView, Occurrence, concerns, due_steps
from handover_datamodels.states import AlertState, Severity

MONDAY = datetime(2026, 3, 2, 12, 0, tzinfo=UTC)
ALERT = AlertView(
    id="urn:ngsi-ld:Alert:demo:a",
    category="device",
    sub_category="deviceAnomaly",
    severity=Severity.HIGH,
    source="urn:ngsi-ld:Device:demo:oven-1",
    place="urn:ngsi-ld:Location:demo:kitchen",
    description="too hot",
    state=AlertState.NEW,
    issued=MONDAY,
    is_active=True,
)


def route(**members: Any) -> Route:
    return Route.model_validate({"channels": ["mail"], **members})


def taken(one: Occurrence, used: Route, now: datetime) -> list[str]:
    """Take the steps that are due, as the follower does."""
    found = list(due_steps(one, {"r": used}, now))
    for due in found:
        one.taken[due.key] = now
    return [due.step for due in found]


def test_a_route_includes_alerts_by_severity_category_source_and_place() -> None:
    for fits in (
        {},
        {"minimumSeverity": "high"},
        {"categories": ["dev*"], "subCategories": ["deviceAnomaly"]},
        {"sources": ["*:oven-*"], "places": ["*:kitchen", "*:hall"]},
    ):
        assert concerns(route(**fits), ALERT)
    for other in (
        {"minimumSeverity": "critical"},
        {"categories": ["task"]},
        {"sources": ["*:lamp-*"]},
        {"places": ["*:hall"]},
        {"enabled": False},
    ):
        assert not concerns(route(**other), ALERT)


def test_each_step_is_taken_once_and_escalation_ends_with_the_acknowledgement() -> None:
    used = route(escalations=[{"afterS": 60, "channels": ["boss"]}, {"afterS": 600, "channels": ["all"]}])
    one = Occurrence(ALERT)
    assert taken(one, used, MONDAY) == ["raised"]
    assert taken(one, used, MONDAY + timedelta(seconds=59)) == []
    assert taken(one, used, MONDAY + timedelta(seconds=61)) == ["escalation-1"]
    one.alert = replace(ALERT, state=AlertState.ACKNOWLEDGED)
    assert taken(one, used, MONDAY + timedelta(hours=1)) == []
    one.alert = replace(one.alert, is_active=False, state=AlertState.RETURNED_TO_NORMAL)
    assert taken(one, used, MONDAY + timedelta(hours=2)) == ["cleared"]
    assert taken(one, used, MONDAY + timedelta(hours=3)) == []


def test_what_was_never_sent_is_not_sent_as_cleared_or_when_it_is_old() -> None:
    over = replace(ALERT, is_active=False, state=AlertState.RETURNED_TO_NORMAL)
    assert taken(Occurrence(over), route(), MONDAY) == []
    assert taken(Occurrence(ALERT), route(), MONDAY + timedelta(days=2)) == []
    assert taken(Occurrence(replace(ALERT, state=AlertState.SHELVED)), route(), MONDAY) == []


def test_quiet_hours_delay_what_is_not_urgent() -> None:
    quiet = route(
        timeZone="Europe/Berlin",
        quietHours=[{"begin": "22:00", "end": "06:00"}],
    )
    night = datetime(2026, 3, 2, 23, 0, tzinfo=UTC)  # midnight in Berlin
    one = Occurrence(replace(ALERT, issued=night))
    assert taken(one, quiet, night) == []
    assert taken(one, quiet, night + timedelta(hours=5)) == []
    assert taken(one, quiet, night + timedelta(hours=6)) == ["raised"]
    critical = Occurrence(replace(ALERT, severity=Severity.CRITICAL, issued=night))
    assert taken(critical, quiet, night) == ["raised"]


def test_hours_that_end_on_the_next_day_belong_to_the_day_of_their_begin() -> None:
    friday_night = Hours.model_validate({"days": ["fri"], "begin": "22:00", "end": "06:00"})
    friday = datetime(2026, 3, 6, 0, 0, tzinfo=UTC)
    hours = [friday_night.include(friday + timedelta(hours=hour)) for hour in (5, 21, 22, 24, 29, 30)]
    assert hours == [False, False, True, True, True, False]
    working = Hours.model_validate({"days": ["mon"], "begin": "08:00", "end": "17:00"})
    assert [working.include(MONDAY.replace(hour=hour)) for hour in (7, 8, 16, 17)] == [
        False,
        True,
        True,
        False,
    ]


@given(st.lists(st.integers(0, 5000), max_size=40), st.integers(0, 40))
def test_no_step_is_taken_twice_whenever_one_looks(seconds: list[int], acknowledged_at: int) -> None:
    used = route(escalations=[{"afterS": 60, "channels": ["a"]}, {"afterS": 90, "channels": ["b"]}])
    one, steps = Occurrence(ALERT), []
    for number, second in enumerate(sorted(seconds)):
        if number == acknowledged_at:
            one.alert = replace(ALERT, state=AlertState.ACKNOWLEDGED)
        steps += taken(one, used, MONDAY + timedelta(seconds=second))
    assert len(set(steps)) == len(steps)


def test_the_file_is_checked_and_its_faults_are_named(tmp_path: Path) -> None:
    file = tmp_path / "routes.yaml"
    file.write_text("channels: {m: {type: mail, to: [a@b.example]}}\nroutes: {all: {channels: [m]}}\n")
    assert read_configuration(file).routes["all"].channels == ("m",)
    for text, fault in (
        ("routes: {all: {channels: [m]}}", 'has the channel "m"'),
        ("channels: {m: {type: mail, to: ['a@b\\nBcc: c@d']}}", "no mail address"),
        ('channels: {m: {type: mail, to: ["a@b.example\\nBcc: c@d.example"]}}', "no mail address"),
        ("channels: {m: {type: webhook, url: 'ftp://x'}}", "http or https"),
        ("channels: {m: {type: pigeon}}", "channels.m"),
        ("routes: {all: {channels: [], timeZone: Mars}}", "routes.all"),
        ("channels: {'': {type: mail, to: [a@b.example]}}", "no name"),
        ("{", "cannot be read"),
    ):
        file.write_text(text)
        with pytest.raises(UsageError, match=fault):
            read_configuration(file)
