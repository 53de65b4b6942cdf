"""Drives several processes that share the agents of one cell, as the orchestrator does."""

from collections.abc import Iterator
from datetime import timedelta
from itertools import count
from typing import Any

from handover_bpmn.definitions import Definitions
from handover_bpmn.notation.file import read_bpmn
from handover_datamodels.entities import Task, TaskStatus
from handover_datamodels.times import iso
from handover_processes.allocation.agents import Agent, Agents
from handover_processes.allocation.allocator import Allocator
from handover_processes.process.process import Process
from handover_processes.records.processes import ProcessRecord, ReservationState
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskRecord
from handover_processes.settings import OrchestratorSettings
from services.task_orchestrator.tests.unit.drawing import NOW
from services.task_orchestrator.tests.unit.process_driver import DEFINED_BY

MAX_ROUNDS = 20


def urn(name: str) -> str:
    return f"urn:ngsi-ld:Device:demo:{name}"


def definitions(*files: bytes) -> Definitions:
    return Definitions(definition for file in files for definition in read_bpmn(file).definitions)


class SharedCell:
    """Processes, and the agents that they share."""

    def __init__(self, *files: bytes, **agents: Agent) -> None:
        self.settings = OrchestratorSettings(_env_file=None)
        self.library = definitions(*files)
        self.allocator = Allocator(self.settings)
        self.allocator.rules.agents = Agents({urn(name): agent for name, agent in agents.items()})
        self.processes: dict[str, Process] = {}
        self.now = NOW
        self._numbers: Iterator[int] = count(1)

    def start(self, definition: str, **parameters: Any) -> str:
        name = f"{definition}-{next(self._numbers)}"
        record = ProcessRecord(
            id=name,
            definition=definition,
            version=1,
            key=None,
            status=TaskStatus.IN_PROGRESS,
            parameters=parameters,
            variables=parameters,
            waiting=(),
            reason=None,
            started_at=self.now,
            ended_at=None,
            revision=1,
            state=None,
        )
        self.processes[name] = Process.start(
            self.settings,
            self.library.plans[definition],
            record,
            Step(1),
            self.now,
            library=self.library,
            allocator=self.allocator,
        )
        self.settle()
        return name

    def settle(self) -> None:
        """Try again what waits, as after each change."""
        self.now += timedelta(seconds=1)
        for _ in range(MAX_ROUNDS):
            if not self.allocator.has_changed:
                return
            self.allocator.has_changed = False
            for name in self.allocator.waiting():
                self.processes[name].allocate(Step(1), self.now)
        raise AssertionError("the allocation does not come to an end")

    def restart(self) -> None:
        """Load all processes from their records, as after kill -9."""
        agents = self.allocator.rules.agents
        self.allocator = Allocator(self.settings)
        self.allocator.rules.agents = agents
        for name, process in self.processes.items():
            self.processes[name] = Process.resume(
                self.settings,
                process.plan,
                process.record,
                list(process.tasks.values()),
                self.library,
                allocator=self.allocator,
            )
        self.settle()

    def open(self) -> list[tuple[str, TaskRecord]]:
        return [(name, task) for name, each in self.processes.items() for task in each.tasks.values()]

    def works(self, process: str) -> dict[str, str]:
        """Return the performer of each open Task of a process, by element."""
        return {task.element: performer(task) for task in self.processes[process].tasks.values()}

    def report(self, process: str, element: str, status: str = "completed", **outputs: Any) -> None:
        """Report the end of the open Task of an element."""
        known = next(each for each in self.processes[process].tasks.values() if each.element == element)
        self.report_task(process, known, status, **outputs)

    def report_task(self, process: str, known: TaskRecord, status: str = "completed", **outputs: Any) -> None:
        entity = {
            "id": known.id,
            "type": "Task",
            "isDefinedBy": DEFINED_BY,
            "status": {"type": "Property", "value": status, "observedAt": iso(self.now)},
            "outputParameters": {"type": "Property", "value": outputs},
        }
        self.processes[process].receive(Task.from_ngsild(entity), Step(1), self.now)
        self.settle()

    def held(self) -> list[tuple[str, str]]:
        """Return the process and each agent of the reservations that are held."""
        return [
            (name, agent)
            for name, process in self.processes.items()
            for each in process.record.reservations
            if each.state is ReservationState.HELD and each.outer is None
            for agent in each.agents
        ]


def performer(task: TaskRecord) -> str:
    involved = task.entity["involves"]["value"]
    return str(involved[0]["object"]).rpartition(":")[2] if involved else ""
