"""The store: a step is written whole or not at all, on SQLite and on PostgreSQL."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import event, text

from handover.database import connect
from handover.errors import Problem
from handover.messages import message
from handover_datamodels.entities import TaskStatus
from handover_processes.records.definitions import DefinitionRecord
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import Act, ActKind, IncidentRecord, ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.tasks import Move, TaskRecord
from handover_processes.storage.process_filter import ProcessFilter
from handover_processes.storage.store import Store
from handover_processes.storage.transaction import Conflict
from services.task_orchestrator.tests.unit.drawing import NOW
from services.task_orchestrator.tests.unit.earlier_tables import take_back

ODD: dict[str, Any] = {"text": "größer \u0000 'quoted'", "list": [1, None, {"deep": True}]}


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    url = f"sqlite:///{tmp_path / 'orchestrator.db'}"
    if request.param == "postgresql":
        url = request.getfixturevalue("new_database")()
    store = Store(connect(url))
    store.migrate()
    yield store
    store.close()


PROCESS = ProcessRecord(
    id="p-1",
    definition="p",
    version=1,
    key="order 7",
    status=TaskStatus.IN_PROGRESS,
    parameters=ODD,
    variables=ODD,
    waiting=("work",),
    reason=None,
    started_at=NOW,
    ended_at=None,
    revision=1,
    state=b"\x00\xff",
)
TASK = TaskRecord(
    id="urn:ngsi-ld:Task:demo:p-1-work-1",
    process="p-1",
    element="work",
    visit=1,
    token="t",
    status=TaskStatus.PENDING,
    observed_at=NOW,
    moves=0,
    created_at=NOW,
    deadline=NOW + timedelta(minutes=5),
    entity=ODD,
)


def first_step() -> Step:
    step = Step(1, processes={"p-1": PROCESS}, tasks={TASK.id: TASK}, new={"p-1", TASK.id})
    step.definitions.append(DefinitionRecord("p", 1, "d", "Title", None, b"<xml/>", NOW))
    step.enqueue("p-1", MessageKind.CREATE, TASK.id, ODD)
    return step


def test_what_was_written_is_read_as_it_was(store: Store) -> None:
    step = first_step()
    store.write(step)
    assert store.unfinished() == [PROCESS]
    assert store.processes(["p-1"]) == [PROCESS]
    assert store.page(ProcessFilter(status="completed")) == []
    assert store.by_key("order 7") == PROCESS
    assert store.tasks("p-1") == [TASK]
    assert store.definitions() == step.definitions
    assert store.outbox() == step.messages


def test_processes_of_earlier_releases_are_numbered_in_the_order_of_their_start(store: Store) -> None:
    started = [("a", "p", 2), ("b", "q", 0), ("c", "p", 0), ("d", "p", 1)]
    step = Step(1)
    for id_, definition, minutes in started:
        at = NOW + timedelta(minutes=minutes)
        step.processes[id_] = replace(PROCESS, id=id_, definition=definition, key=None, started_at=at)
    step.new = set(step.processes)
    store.write(step)
    store.lock.release()
    with store.engine.begin() as connection:
        take_back(connection, 5)
    store.migrate()
    assert {each.id: (each.number, each.title) for each in store.unfinished()} == {
        "a": (3, None),
        "b": (1, None),
        "c": (1, None),
        "d": (2, None),
    }
    assert store.process_numbers() == {"p": 3, "q": 1}
    twice = replace(PROCESS, id="e", key=None, number=3)
    with pytest.raises(Conflict, match="exists already"):
        store.write(Step(1, processes={"e": twice}, new={"e"}))


def test_a_later_step_replaces_and_strikes_off(store: Store) -> None:
    store.write(first_step())
    done = TASK.changed(status=TaskStatus.COMPLETED, ended_at=NOW, moves=1, outputs=ODD)
    over = replace(PROCESS, status=TaskStatus.COMPLETED, ended_at=NOW, state=None, revision=2, waiting=())
    step = Step(2, processes={"p-1": over}, tasks={TASK.id: done}, delivered=[1])
    step.moves.append(Move(TASK.id, 1, TaskStatus.COMPLETED, None, NOW))
    store.write(step)
    assert store.unfinished() == []
    assert store.tasks("p-1") == [done]
    assert store.moves("p-1") == step.moves
    assert store.outbox() == []


def test_an_ended_process_with_a_task_that_has_not_is_not_over(store: Store) -> None:
    step = first_step()
    step.processes["p-1"] = replace(PROCESS, ended_at=NOW, state=None)
    store.write(step)
    assert [process.id for process in store.unfinished()] == ["p-1"]


@pytest.mark.parametrize("broken", ["news taken in twice", "moved by somebody else", "key taken"])
def test_a_step_that_cannot_be_written_leaves_nothing_behind(store: Store, broken: str) -> None:
    store.write(first_step())
    step = Step(2, processes={"p-1": replace(PROCESS, revision=2)}, tasks={TASK.id: TASK.changed(moves=1)})
    step.enqueue("p-1", MessageKind.CLEAR, "x", {})
    step.moves.append(Move(TASK.id, 1, TaskStatus.ASSIGNED, NOW, NOW))
    if broken == "news taken in twice":
        step.moves *= 2
    elif broken == "moved by somebody else":
        step.processes["p-1"] = replace(PROCESS, revision=3)
    else:
        step.processes["p-2"] = replace(PROCESS, id="p-2")
        step.new.add("p-2")
    with pytest.raises(Exception, match=r"UNIQUE|unique|another orchestrator|exists already"):
        store.write(step)
    assert store.processes(["p-1", "p-2"]) == [PROCESS]
    assert store.tasks("p-1") == [TASK]
    assert store.moves("p-1") == []
    assert [message.seq for message in store.outbox()] == [1]


def test_two_orchestrators_cannot_both_move_a_process(store: Store) -> None:
    store.write(first_step())
    store.write(Step(2, processes={"p-1": replace(PROCESS, revision=2)}))
    with pytest.raises(Conflict, match="another orchestrator"):
        store.write(Step(2, processes={"p-1": replace(PROCESS, revision=2)}))


def test_migrating_again_changes_nothing(store: Store) -> None:
    store.write(first_step())
    store.migrate()
    assert store.unfinished() == [PROCESS]


def started(name: str, minutes: int, **changes: Any) -> ProcessRecord:
    return replace(PROCESS, id=name, key=None, started_at=NOW + timedelta(minutes=minutes), **changes)


def kept(store: Store, *records: ProcessRecord, tasks: Sequence[TaskRecord] = ()) -> None:
    step = Step(1, processes={record.id: record for record in records}, tasks={t.id: t for t in tasks})
    step.new = {*step.processes, *step.tasks}
    store.write(step)


def test_pages_follow_on_each_other_though_processes_are_started_meanwhile(store: Store) -> None:
    kept(store, *(started(f"p-{n}", n // 3, definition="qp"[n % 2]) for n in range(9)))
    first = [record.id for record in store.page(limit=4)]
    kept(store, started("p-new", 60))
    second = [record.id for record in store.page(limit=4, before=first[-1])]
    third = [record.id for record in store.page(limit=4, before=second[-1])]
    assert first + second + third == [f"p-{n}" for n in reversed(range(9))]
    assert store.page(before=third[-1]) == []
    assert [r.id for r in store.page(ProcessFilter(definition="q"), before="p-5")] == ["p-4", "p-2", "p-0"]
    assert [r.id for r in store.page(ProcessFilter(status="failed"))] == []
    assert {record.state for record in store.page()} == {None}
    with pytest.raises(Problem, match="nobody"):
        store.page(before="nobody")


INCIDENT = IncidentRecord(
    "7", "work", "Work", message("task.no_reason", "no reason given"), NOW, TASK.id, "E7"
)


def test_the_incidents_of_a_process_and_what_people_did_are_kept(store: Store) -> None:
    acts = (Act(NOW, ActKind.RETRY, "Ann \u00e4", TASK.id), Act(NOW, ActKind.CANCEL))
    failed = started("p-1", 0, status=TaskStatus.FAILED, ended_at=NOW, incidents=(INCIDENT,), acts=acts)
    kept(store, failed)
    assert store.processes(["p-1"]) == [failed]
    assert store.unfinished() == []


def test_what_ended_long_ago_is_forgotten_with_all_that_belongs_to_it(store: Store) -> None:
    then = NOW - timedelta(days=9)
    old = started("p-old", 0, ended_at=then)
    busy = started("p-busy", 0, ended_at=then)
    young = started("p-young", 0, ended_at=NOW)
    kept(
        store,
        old,
        busy,
        young,
        started("p-runs", 0),
        tasks=[
            replace(TASK, id="t-old", process="p-old", ended_at=then),
            replace(TASK, id="t-busy", process="p-busy"),
            replace(TASK, id="t-young", process="p-young", ended_at=NOW),
        ],
    )
    moves = [Move(f"t-{name}", 1, TaskStatus.FAILED, None, then) for name in ("old", "young")]
    store.write(Step(9, delivered=[0], moves=moves))
    assert store.delete_ended(NOW - timedelta(days=10), 5) == 0
    assert store.delete_ended(NOW - timedelta(days=8), 5) == 1
    assert {record.id for record in store.page()} == {"p-busy", "p-young", "p-runs"}
    assert (store.tasks("p-old"), store.moves("p-old")) == ([], [])
    assert (len(store.tasks("p-young")), len(store.moves("p-young"))) == (1, 1)
    assert store.delete_ended(NOW + timedelta(days=1), 1) == 1
    with store.engine.connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM orchestrator_inbox")).scalar() == 0


def test_only_a_process_of_which_nothing_is_open_can_be_archived(store: Store) -> None:
    names = ("p-delivered", "p-pending", "p-busy", "p-young", "p-archived")
    ended = {name: NOW + timedelta(minutes=1 if name == "p-young" else 0) for name in names}
    records = [started(name, 0, ended_at=moment) for name, moment in ended.items()]
    records[4] = replace(records[4], archived_at=NOW)
    tasks = [replace(TASK, id=f"t-{name}", process=name, ended_at=NOW) for name in names]
    tasks[2] = replace(tasks[2], ended_at=None)
    kept(store, *records, started("p-runs", 0), tasks=tasks)
    waiting = Step(1)
    waiting.enqueue("p-pending", MessageKind.UPSERT, "urn:p-pending", [])
    store.write(waiting)
    found = store.to_archive(NOW + timedelta(seconds=1), 10)
    assert [(each.process.id, each.tasks) for each in found] == [("p-delivered", ("t-p-delivered",))]
    step = Step(2, archived=[replace(found[0].process, archived_at=NOW, revision=2)])
    step.enqueue("p-delivered", MessageKind.DELETE, "urn:p-delivered", ["t-p-delivered", "urn:p-delivered"])
    store.write(step)
    assert store.to_archive(NOW + timedelta(seconds=1), 10) == []
    (record,) = store.processes(["p-delivered"])
    assert (record.archived_at, record.revision, record.state) == (NOW, 2, PROCESS.state)
    assert store.archived(["t-p-delivered", "t-p-busy", "no"], ["p-archived", "p-young"]) == {
        "t-p-delivered": "p-delivered",
        "p-archived": "p-archived",
    }
    assert {each.task.id: each.archived for each in store.ended_tasks([task.id for task in tasks])} == {
        "t-p-delivered": True,
        "t-p-pending": False,
        "t-p-young": False,
        "t-p-archived": True,
    }
    assert [each.process.id for each in store.ended_processes(["p-runs", "p-young"])] == ["p-young"]
    assert store.delete_ended(NOW + timedelta(days=1), 10, archived_only=True) == 2
    assert store.processes(["p-delivered", "p-archived"]) == []


def test_a_process_that_was_retried_meanwhile_is_not_archived(store: Store) -> None:
    kept(store, started("p-1", 0, ended_at=NOW))
    (found,) = store.to_archive(NOW + timedelta(seconds=1), 10)
    store.write(Step(1, processes={"p-1": started("p-1", 0, revision=2)}))
    archived = replace(found.process, archived_at=NOW, revision=found.process.revision + 1)
    with pytest.raises(Conflict, match="meanwhile"):
        store.write(Step(1, archived=[archived]))
    assert store.processes(["p-1"])[0].archived_at is None


@pytest.mark.parametrize(
    "wanted",
    [
        ProcessFilter(),
        ProcessFilter(status="completed"),
        ProcessFilter(definition="p"),
        ProcessFilter(resource="urn:ngsi-ld:Device:demo:glove-1", status="completed"),
        ProcessFilter(has_incident=True),
        ProcessFilter(is_unallocated=True),
    ],
)
def test_a_page_of_many_processes_is_read_along_an_index(tmp_path: Path, wanted: ProcessFilter) -> None:
    store = Store(connect(f"sqlite:///{tmp_path / 'orchestrator.db'}"))
    store.migrate()
    kept(store, started("p-0", 0))
    plans: list[str] = []

    def explain(connection: Any, cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        if statement.startswith("SELECT") and "ORDER BY" in statement:
            cursor.execute(f"EXPLAIN QUERY PLAN {statement}", parameters)
            plans.extend(str(row[3]) for row in cursor.fetchall())

    event.listen(store.engine, "before_cursor_execute", explain)
    assert store.page(wanted, before="p-0", limit=100) == []
    assert store.to_archive(NOW, 10) == []
    store.close()
    assert any("INDEX" in step for step in plans)
    assert not [step for step in plans if "TEMP B-TREE" in step or step == "SCAN orchestrator_processes"]
