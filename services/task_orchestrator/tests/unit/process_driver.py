"""Drives one process in tests with reports of performers; its decisions are in `step`."""

from datetime import datetime, timedelta
from typing import Any

from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.state import Library
from handover_bpmn.model import Definition
from handover_bpmn.notation.file import read_bpmn
from handover_datamodels.entities import Task, TaskStatus
from handover_datamodels.times import iso
from handover_processes.process.process import Process
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.step import Step
from handover_processes.settings import OrchestratorSettings
from services.task_orchestrator.tests.unit.drawing import NOW, drawing

DEFINED_BY = {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:work"}


def only_process(xml: bytes) -> Definition:
    """Return the definition of a file with one process."""
    (definition,) = read_bpmn(xml).definitions
    return definition


class OneDefinition(Library):
    """A library that has one definition."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan

    def plan(self, name: str, version: int) -> Plan:
        return self._plan

    def find(self, name: str, version: int | None, tag: str | None) -> Plan:
        return self._plan


class ProcessDriver:
    """A process and the last step it made."""

    def __init__(self, body: str, *, beside: str = "", **parameters: Any) -> None:
        self.now = NOW
        self.step = Step(1)
        self.plan = Plan(only_process(drawing(body, beside=beside)))
        record = ProcessRecord(
            id="p-1",
            definition="p",
            version=1,
            key=None,
            status=TaskStatus.IN_PROGRESS,
            parameters=parameters,
            variables=parameters,
            waiting=(),
            reason=None,
            started_at=NOW,
            ended_at=None,
            revision=1,
            state=None,
        )
        settings = OrchestratorSettings(_env_file=None)
        self.process = Process.start(
            settings, self.plan, record, self.step, NOW, library=OneDefinition(self.plan)
        )

    def next_step(self) -> Step:
        self.step = Step(self.step.next_seq)
        return self.step

    def after(self, **time: float) -> datetime:
        self.now += timedelta(**time)
        return self.now

    def receive(self, name: str, status: str, *, at: datetime | None = None, **outputs: Any) -> bool:
        return self.process.receive(self.seen(name, status, at=at, **outputs), self.next_step(), self.now)

    def seen(self, name: str, status: str, *, at: datetime | None = None, **outputs: Any) -> Task:
        return Task.from_ngsild(
            {
                "id": task_id(name),
                "type": "Task",
                "isDefinedBy": DEFINED_BY,
                "status": {"type": "Property", "value": status, "observedAt": iso(at or self.now)},
                "outputParameters": {"type": "Property", "value": outputs},
            }
        )

    def tick(self) -> None:
        self.process.tick(self.next_step(), self.now)

    @property
    def open(self) -> list[str]:
        return sorted(task.removeprefix("urn:ngsi-ld:Task:demo:p-1-") for task in self.process.tasks)


def task_id(name: str) -> str:
    return f"urn:ngsi-ld:Task:demo:p-1-{name}"


def created(step: Step) -> list[str]:
    return [message.subject for message in step.messages if message.kind is MessageKind.CREATE]


def alerts(step: Step) -> list[Any]:
    return [message.body for message in step.messages if message.kind is MessageKind.RAISE]


def processes(step: Step) -> list[Any]:
    return [
        message.body[0]
        for message in step.messages
        if message.kind is MessageKind.UPSERT and message.body[0]["type"] == "Process"
    ]
