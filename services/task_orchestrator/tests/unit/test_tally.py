"""Statistics: what the steps have added up is what a replay of the stored history gives."""

from collections import Counter
from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import delete

from handover.database import connect
from handover.errors import Problem
from handover.messages import message
from handover_datamodels.entities import TaskStatus
from handover_processes.process.tally import count_change, count_end, count_start, count_task
from handover_processes.records.processes import IncidentRecord, ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.tasks import Move, TaskRecord
from handover_processes.reporting.period import read_period
from handover_processes.storage import schema
from handover_processes.storage.rollups import ReportScope
from handover_processes.storage.store import Store
from handover_processes.tally import (
    HOUR_MS,
    WHOLE_PROCESS,
    Counted,
    Period,
    bin_of,
    elapsed_ms,
    hour_of,
    milliseconds,
)
from services.task_orchestrator.tests.unit.drawing import NOW

FINISHED = (TaskStatus.COMPLETED, TaskStatus.FAILED)
ROBOT = "urn:ngsi-ld:Device:demo:ur10-1"
EVERYTHING = Period(hour_of(NOW) - 48, hour_of(NOW) + 24 * 90)
SCOPE = ReportScope("p", 2)


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Store]:
    url = f"sqlite:///{tmp_path_factory.mktemp('tally') / 'tally.db'}"
    if request.param == "postgresql":
        url = request.getfixturevalue("new_database")()
    store = Store(connect(url))
    store.migrate()
    yield store
    store.close()


@pytest.fixture
def empty(store: Store) -> Store:
    with store.engine.begin() as connection:
        for table in reversed(schema.processes.metadata.sorted_tables):
            connection.execute(delete(table))
    return store


def process(number: int, **changes: Any) -> ProcessRecord:
    values: dict[str, Any] = {
        "id": f"p-{number}",
        "definition": "p",
        "version": 2,
        "key": None,
        "status": TaskStatus.IN_PROGRESS,
        "parameters": {},
        "variables": {},
        "waiting": (),
        "reason": None,
        "started_at": NOW,
        "ended_at": None,
        "revision": 1,
        "state": None,
    }
    return ProcessRecord(**values | changes)


def task(number: int, element: str, of: str, created_at: datetime) -> TaskRecord:
    return TaskRecord(
        id=f"urn:ngsi-ld:Task:demo:{of}-{element}-{number}",
        process=of,
        element=element,
        visit=number,
        token="t",
        status=TaskStatus.PENDING,
        observed_at=None,
        moves=0,
        created_at=created_at,
        deadline=created_at,
        entity={"involves": {"value": [{"object": ROBOT}]}},
    )


def changed(step: Step, of: ProcessRecord, known: TaskRecord, status: TaskStatus, at: datetime) -> TaskRecord:
    """Change a Task as a process does."""
    counted = count_change(step, of, known, {}, at)
    is_final = status in FINISHED
    after = counted.changed(status=status, moves=known.moves + 1, ended_at=at if is_final else None)
    count_task(step, of, after)
    step.moves.append(Move(known.id, after.moves, status, None, at))
    return after


def as_new(*records: Any, moves: Any = ()) -> Step:
    step = Step(1, moves=list(moves))
    for record in records:
        place: dict[str, Any] = step.tasks if isinstance(record, TaskRecord) else step.processes
        place[record.id] = record
        step.new.add(record.id)
    return step


MINUTES = st.integers(0, 60 * 24 * 3)
COURSES = st.lists(
    st.tuples(
        st.sampled_from(["scan", "pick"]),
        MINUTES,
        st.lists(
            st.tuples(
                st.sampled_from([TaskStatus.ASSIGNED, TaskStatus.IN_PROGRESS, TaskStatus.PAUSED]), MINUTES
            ),
            max_size=4,
        ),
        st.sampled_from([*FINISHED, None]),
        MINUTES,
    ),
    max_size=6,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], max_examples=40)
@given(courses=COURSES, ends=st.sampled_from([*FINISHED, None]), took=MINUTES)
def test_sums_agree_with_a_replay_of_the_history(
    store: Store, courses: list[Any], ends: TaskStatus | None, took: int
) -> None:
    with store.engine.begin() as connection:
        for table in reversed(schema.processes.metadata.sorted_tables):
            connection.execute(delete(table))
    step = Step(1)
    running = process(1)
    count_start(step, running)
    for number, (element, begins, moves, final, ending) in enumerate(courses):
        at = NOW + timedelta(minutes=begins)
        known = task(number, element, running.id, at)
        for status, lasting in [*moves, (final, ending)]:
            if status is not None:
                at += timedelta(minutes=lasting, milliseconds=number)
                known = changed(step, running, known, status, at)
        step.tasks[known.id] = known
        step.new.add(known.id)
    if ends is not None:
        running = process(1, status=ends, ended_at=NOW + timedelta(minutes=took))
        count_end(step, running)
    step.processes[running.id] = running
    step.new.add(running.id)
    store.write(step)

    counted: Counter[tuple[str, Counted]] = Counter()
    sums: Counter[tuple[str, Counted, str]] = Counter()
    worked = 0
    for known in store.tasks(running.id):
        at, status, spent = known.created_at, TaskStatus.PENDING, Counter[TaskStatus]()
        for move in [each for each in store.moves(running.id) if each.task == known.id]:
            spent[status] += elapsed_ms(at, move.received_at)
            at, status = move.received_at, move.status
        worked += spent[TaskStatus.IN_PROGRESS]
        if status not in FINISHED:
            continue
        key = known.element, Counted(status.value)
        counted[key] += 1
        sums[*key, "duration"] += elapsed_ms(known.created_at, at)
        sums[*key, "working"] += spent[TaskStatus.IN_PROGRESS]
        sums[*key, "paused"] += spent[TaskStatus.PAUSED]
        sums[*key, "waiting"] += spent[TaskStatus.PENDING] + spent[TaskStatus.ASSIGNED]

    report = store.reports.elements(EVERYTHING, SCOPE)
    found = {key: each.total for key, each in report.durations.items() if key[0] != WHOLE_PROCESS}
    assert {key: each.counted for key, each in found.items()} == counted
    for key, each in found.items():
        assert each.duration_ms == sums[*key, "duration"]
        assert each.working_ms == sums[*key, "working"]
        assert each.paused_ms == sums[*key, "paused"]
        assert each.waiting_ms == sums[*key, "waiting"]
    present = {each.status for each in store.tasks(running.id)}
    if TaskStatus.IN_PROGRESS not in present:
        assert store.reports.work(EVERYTHING, SCOPE, NOW).get(ROBOT, 0) == worked
    whole = {key[1]: each.total.counted for key, each in report.durations.items() if key[0] == WHOLE_PROCESS}
    assert whole == {Counted.STARTED: 1} | ({} if ends is None else {Counted(ends.value): 1})


@given(durations=st.lists(st.integers(1, 10**9), min_size=1, max_size=60), share=st.sampled_from([0.5, 0.9]))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], max_examples=25)
def test_percentiles_are_within_nine_percent(store: Store, durations: list[int], share: float) -> None:
    with store.engine.begin() as connection:
        connection.execute(delete(schema.statistics))
    for number, duration in enumerate(durations):
        ended = process(number, status=TaskStatus.COMPLETED, ended_at=NOW + timedelta(milliseconds=duration))
        step = Step(1)
        count_end(step, ended)
        store.write(step)
    report = store.reports.elements(EVERYTHING, SCOPE)
    completed = report.durations[WHOLE_PROCESS, Counted.COMPLETED]
    exact = sorted(durations)[max(0, -int(-share * len(durations) // 1) - 1)]
    assert completed.percentile_ms(share) == pytest.approx(exact, rel=0.0906, abs=1)
    assert completed.mean_ms() == pytest.approx(sum(durations) / len(durations), abs=1)


def test_a_period_reads_long_rows_and_shorter_ones_at_its_ends(empty: Store) -> None:
    first = NOW.replace(hour=0)
    for number in range(24 * 4):
        step = Step(1)
        count_start(step, process(number, started_at=first + timedelta(hours=number)))
        empty.write(step)
    begin = hour_of(first)
    for begins, ends in ((0, 96), (1, 95), (5, 7), (23, 25), (24, 48), (30, 95)):
        period = Period(begin + begins, begin + ends)
        (row,) = empty.reports.definitions(period).durations.items()
        assert row[0] == ("p", Counted.STARTED)
        assert row[1].total.counted == ends - begins
        by_hour = empty.reports.throughput(period, ReportScope(), 1)
        assert by_hour == {(hour, Counted.STARTED): 1 for hour in range(period.begins, period.ends)}


@given(st.integers(400_000, 410_000), st.integers(0, 9_000))
def test_spans_contain_each_hour_of_a_period_once(begins: int, hours: int) -> None:
    spans = list(Period(begins, begins + hours).spans())
    covered = [hour for length, first, end in spans for hour in range(first, end) if first % length == 0]
    assert covered == list(range(begins, begins + hours))
    assert sum((end - first) // length for length, first, end in spans) < 2 * (23 + 29) + 13


def test_work_counts_in_the_hours_in_which_it_was_done(empty: Store) -> None:
    begins = NOW.replace(minute=50)
    step = Step(1)
    working = task(1, "pick", "p-1", begins).changed(status=TaskStatus.IN_PROGRESS, status_since=begins)
    ended = changed(step, process(1), working, TaskStatus.COMPLETED, begins + timedelta(minutes=80))
    present = task(2, "pick", "p-1", begins).changed(
        status=TaskStatus.IN_PROGRESS, status_since=begins + timedelta(minutes=100)
    )
    empty.write(step)
    empty.write(as_new(process(1), present, ended))
    hour, now = hour_of(begins), begins + timedelta(minutes=120)
    for offset, minutes in ((0, 10), (1, 60), (2, 10 + 20)):
        worked = empty.reports.work(Period(hour + offset, hour + offset + 1), SCOPE, now)
        assert worked[ROBOT] == minutes * 60_000
    assert empty.reports.work(Period(hour, hour + 3), ReportScope("p", 1), now) == {}


def test_what_was_counted_long_ago_is_deleted(empty: Store) -> None:
    for days in (0, 9):
        step = Step(1)
        count_start(step, process(days, started_at=NOW - timedelta(days=days)))
        empty.write(step)
    empty.delete_statistics(NOW - timedelta(days=5))
    everything = Period(hour_of(NOW) - 24 * 20, hour_of(NOW) + 24)
    started = empty.reports.throughput(everything, ReportScope(), 1)
    assert started == {(hour_of(NOW), Counted.STARTED): 1}


def test_incidents_are_grouped_by_element_and_cause(empty: Store) -> None:
    def stopped(number: int, reason: str, element: str = "pick") -> ProcessRecord:
        since = NOW + timedelta(minutes=number)
        incident = IncidentRecord("1", element, element.title(), reason, since)
        return process(number, started_at=since, incidents=(incident,))

    no_reason = message("task.no_reason", "no reason given")
    records = [*(stopped(number, no_reason) for number in range(7)), stopped(7, "jammed"), process(8)]
    empty.write(as_new(*records))
    first, second = empty.reports.incidents(SCOPE)
    assert (first.element, first.count, first.reason["reasonCode"]) == ("pick", 7, "task.no_reason")
    assert (first.since, first.processes) == (NOW, ["p-6", "p-5", "p-4", "p-3", "p-2"])
    assert (second.count, second.reason["reason"]) == (1, "jammed")
    report = empty.reports.definitions(EVERYTHING)
    assert (report.running["p"].running, report.running["p"].stopped) == (9, 8)


@pytest.mark.parametrize(("days", "word"), [(-1, "empty"), (400, "366 days")])
def test_a_period_is_bounded(days: int, word: str) -> None:
    with pytest.raises(Problem, match=word):
        read_period(NOW - timedelta(days=days), NOW, NOW)


@given(st.integers(0, 10**12))
def test_bins_are_in_the_order_of_durations(duration: int) -> None:
    assert bin_of(duration) <= bin_of(duration + 1)
    assert milliseconds(NOW) % HOUR_MS == 0
