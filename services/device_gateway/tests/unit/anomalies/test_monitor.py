"""The monitor: which values are watched, and what an earlier run had found."""

from pathlib import Path
from typing import Any

import pytest

from handover.database import connect
from handover.errors import UsageError
from handover_devices.anomalies import monitor as monitors
from handover_devices.anomalies.baseline import baseline_of
from handover_devices.anomalies.monitor import Monitor, WatchKey
from handover_devices.anomalies.rules import Rule, SeasonalCheck, read_rules
from handover_devices.storage import history, schema
from handover_devices.storage.history_writer import HistoryWriter

HOT = Rule.model_validate(
    {"device": "hall-*", "value": "temperature", "check": {"type": "limits", "maximum": 30}}
)
KEY = WatchKey("hot", "hall-1", "temperature")


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


def new_monitor(clock: Clock, rule: Rule = HOT, **rows: Any) -> Monitor:
    made = Monitor(clock, clock)
    made.load(rows.get("known", ()))
    made.set_rule("hot", rule)
    made.set_device("hall-1", ("temperature", "humidity"))
    made.set_device("cellar-1", ("temperature",))
    made.discard_unknown()
    return made


def test_rules_watch_the_values_that_their_patterns_name() -> None:
    monitor = new_monitor(Clock())
    assert list(monitor.watches) == [KEY]
    monitor.observe("hall-1", {"temperature": 31, "humidity": 99}, 1.0)
    monitor.observe("cellar-1", {"temperature": 31}, 1.0)
    assert list(monitor.changed) == [KEY]
    monitor.changed.clear()
    monitor.observe("hall-1", {"temperature": 20}, 0.5)  # older than the last one: judged no more
    assert not monitor.changed
    monitor.set_device("hall-1", ("humidity",))
    assert monitor.removed == {KEY: True}
    assert not monitor.watches


def test_an_alarm_of_an_earlier_run_is_known_and_one_of_a_deleted_rule_is_cleared() -> None:
    clock = Clock()
    first = new_monitor(clock)
    first.observe("hall-1", {"temperature": 31}, 1.0)
    row = first.watches[KEY].row()
    again = new_monitor(clock, known=[row, row._replace(rule="gone", reported=1)])
    assert again.watches[KEY].alarm.is_on
    assert list(again.changed) == [KEY]  # its Alert was not raised yet
    assert again.removed == {WatchKey("gone", "hall-1", "temperature"): True}
    reported = new_monitor(clock, known=[row._replace(reported=1)])
    assert not reported.changed
    reported.observe("hall-1", {"temperature": 20}, 2.0)
    assert list(reported.changed) == [KEY]


def test_a_device_is_silent_only_after_its_time_since_the_start() -> None:
    clock = Clock()
    monitor = new_monitor(clock, Rule.model_validate({"check": {"type": "silence", "afterS": 60}}))
    clock.now += 50
    monitor.observe("hall-1", {"temperature": 1}, clock.now)
    clock.now += 20
    monitor.check_silence()
    assert sorted((key.device, key.value) for key in monitor.changed) == [
        ("cellar-1", "temperature"),
        ("hall-1", "humidity"),
    ]


def test_watches_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(monitors, "MAX_WATCHES", 2)
    monitor = new_monitor(Clock(), Rule.model_validate({"check": {"type": "limits", "maximum": 1}}))
    assert (len(monitor.watches), monitor.skipped) == (2, 1)


def test_rules_are_read_from_a_file_and_faults_are_named(tmp_path: Path) -> None:
    file = tmp_path / "rules.yaml"
    file.write_text(
        "rules:\n  hot:\n    device: hall-*\n    check: {type: limits, maximum: 30}\n    severity: high\n"
    )
    assert read_rules(file)["hot"].severity == "high"
    for text, fault in (
        ("rules: {hot: {check: {type: limits}}}", "rules.hot.check.limits"),
        ("rules: {'a b': {check: {type: silence, afterS: 1}}}", "no name"),
        ("rules: {hot: {value: 1}}", "rules.hot"),
        ("[", "cannot be read"),
        ("", "the file"),
    ):
        file.write_text(text)
        with pytest.raises(UsageError, match=fault):
            read_rules(file)


async def test_a_baseline_has_what_is_usual_at_each_time_of_the_day(tmp_path: Path) -> None:
    engine = connect(f"sqlite:///{tmp_path / 'devices.db'}")
    schema.prepare(engine)
    writer = HistoryWriter(engine)
    day_us, start_us = 86_400_000_000, 20_000 * 86_400_000_000
    writer.add(
        values=[
            ("d", "load", start_us + day * day_us + minute * 60_000_000, 100 + day if minute >= 720 else 10.0)
            for day in range(5)
            for minute in range(0, 1440, 10)
        ]
    )
    await writer.close()
    series = history.series_of(engine, "d")["load"]
    check = SeasonalCheck(interval_min=60)
    baseline = baseline_of(engine, series, check, (start_us + 5 * day_us) / 1e6)
    engine.dispose()
    assert baseline.at(3600.0 * 5) == (10.0, 0.0, 5)
    mean, deviation, days = baseline.at(3600.0 * 13) or (0, 0, 0)
    assert (mean, days) == (102.0, 5)
    assert deviation == pytest.approx(2.5**0.5)
