"""A service that the bridge serves on the graph: a node calls it to request a Task."""

import asyncio
import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.errors import HandoverError
from handover.settings import Settings
from handover.tasks.task_life import FINISHED
from handover.telemetry import get_logger
from handover_datamodels.entities import Task, TaskStatus
from handover_datamodels.times import iso
from handover_ros.graph.port import Message, RosGraph, Served
from handover_ros.mapping import paths
from handover_ros.mapping.templates import Template
from handover_ros.mapping.values import Source
from handover_ros.rules import conversion
from handover_ros.rules.entity_extractor import MESSAGE_ERRORS
from handover_ros.rules.json_values import JsonValues
from handover_ros.rules.message_builder import Scope
from handover_ros.rules.message_schema import PathTarget
from handover_ros.rules.plan import Plan, PlannedServedService
from handover_ros.running.rule_stats import RuleStats

log = get_logger(__name__)

POLL_INTERVAL_S = 0.25


class ServedService:
    """Serves the service of one rule between `start` and `stop`."""

    def __init__(
        self,
        planned: PlannedServedService,
        stats: RuleStats,
        graph: RosGraph,
        broker: BrokerClient,
        *,
        settings: Settings,
        plan: Plan,
    ) -> None:
        self.planned = planned
        self.stats = stats
        self._graph = graph
        self._broker = broker
        self._settings = settings
        self._placeholders = plan.settings
        self._to_json = JsonValues(plan.definitions, 10_000, large_arrays=False)
        self._served: Served | None = None

    async def start(self) -> None:
        """Start serving. Raises `GraphError`."""
        if self._served is None:
            rule = self.planned.rule
            self._served = await self._graph.serve(rule.service, rule.type, self._answer)

    async def stop(self) -> None:
        """Stop serving."""
        if self._served is not None:
            served, self._served = self._served, None
            await served.close()

    async def _answer(self, request: Message) -> Message:
        clock = asyncio.get_running_loop().time
        self.stats.count_received(clock())
        task_id = self._settings.entity_id("Task", f"{self.planned.name}-{uuid.uuid4().hex[:12]}")
        answer: dict[str, Any] = {"id": task_id, "accepted": False, "completed": False}
        try:
            await self._broker.create(self._task(task_id, request))
            answer |= {"accepted": True, "status": TaskStatus.PENDING.value}
            self.stats.count_forwarded(clock(), {"task": task_id})
            if self.planned.rule.answer == "finished":
                answer |= await self._result_of(task_id)
        except MESSAGE_ERRORS as error:
            self.stats.record_error(str(error), clock())
            answer["reason"] = str(error)
        values = {name: value for name, value in answer.items() if value is not None}
        try:
            return self.planned.response.message(Scope(values))
        except MESSAGE_ERRORS as error:
            self.stats.record_error(f"the response cannot be built: {error}", clock())
            return {}

    def _task(self, task_id: str, request: Message) -> Task:
        asked = self.planned.rule.task
        parameters = {name: self._value(source, request) for name, source in asked.parameters.items()}
        arguments = {name: value for name, value in parameters.items() if value is not None}
        definition = self._settings.entity_id("TaskDefinition", self._filled(asked.definition, request))
        now = iso(datetime.now(UTC))
        entity: dict[str, Any] = {
            "id": task_id,
            "type": "Task",
            "isDefinedBy": {"type": "Relationship", "object": definition},
            "status": {"type": "Property", "value": TaskStatus.PENDING.value, "observedAt": now},
            "involves": {
                "type": "Property",
                "value": [
                    {"type": "Relationship", "object": resource} for resource in self.planned.resources
                ],
            },
        }
        if asked.description is not None:
            description = self._filled(asked.description, request)
            entity["description"] = {"type": "Property", "value": description}
            arguments.setdefault("description", description)
        entity["workParameters"] = {"type": "Property", "value": arguments}
        return Task.from_ngsild(entity)

    def _value(self, source: Source, request: Message) -> Any:
        if source.attribute is not None:
            value = paths.getter(source.attribute)(request)
            value = self._to_json.maker(PathTarget(None), str(source.attribute))(value)
        elif source.text is not None:
            value = self._filled(source.text, request)
        else:
            value = source.constant
        convert = conversion.compiled(source)
        return value if convert is None else convert(value)

    def _filled(self, template: Template, request: Mapping[str, Any]) -> str:
        filler = template.with_settings(self._placeholders).filler(paths.getter)
        return filler(request)

    async def _result_of(self, task_id: str) -> dict[str, Any]:
        """Wait until the Task has finished and return its part of the response."""
        try:
            async with asyncio.timeout(self.planned.rule.timeout_s):
                while True:
                    task = await self._retrieve(task_id)
                    if task is not None and task.status.value in FINISHED:
                        break
                    await asyncio.sleep(POLL_INTERVAL_S)
        except TimeoutError:
            raise HandoverError(
                f"{task_id} was not finished within {self.planned.rule.timeout_s:g} s; it continues"
            ) from None
        outputs = dict(task.output_parameters.value) if task.output_parameters is not None else {}
        done = task.status.value is TaskStatus.COMPLETED
        return {
            "completed": done,
            "status": task.status.value.value,
            "outputs": outputs,
            "reason": None if done else str(outputs.get("reason", "failed")),
        }

    async def _retrieve(self, task_id: str) -> Task | None:
        try:
            return await self._broker.get(task_id, Task)
        except BrokerUnavailable as error:
            log.info("retrieving a Task failed, retrying", task=task_id, error=str(error))
            return None
        except BrokerError as error:
            raise HandoverError(f"{task_id} cannot be retrieved: {error}") from None
