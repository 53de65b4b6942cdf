"""Definition registry: all versions of the deployed definitions; a running process keeps its version."""

import asyncio
import hashlib
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from handover.errors import HandoverError, Problem
from handover.messages import message, text_of
from services.task_orchestrator.bpmn import read_bpmn
from services.task_orchestrator.definition import BadBpmn, Definition, Fault
from services.task_orchestrator.engine import Plan, RunFailed
from services.task_orchestrator.entities import definition_entities
from services.task_orchestrator.records import DefinitionRecord
from services.task_orchestrator.settings import OrchestratorSettings


@dataclass(frozen=True, slots=True)
class Deployment:
    """The result of a deployment; `created` is False when it changed nothing."""

    name: str
    version: int
    created: bool


class DefinitionRegistry:
    """All definitions by name and version."""

    def __init__(self, settings: OrchestratorSettings) -> None:
        self._settings = settings
        self._records: dict[str, list[DefinitionRecord]] = {}
        self._plans: dict[str, Plan] = {}
        """By the digest of the file."""

    def add(self, records: Iterable[DefinitionRecord]) -> None:
        """Add `records`, in the order of their versions."""
        for record in records:
            self._records.setdefault(record.name, []).append(record)

    def latest(self) -> list[DefinitionRecord]:
        """Return the latest version of each definition."""
        return [self._records[name][-1] for name in sorted(self._records)]

    def record(self, name: str, version: int | None = None) -> DefinitionRecord:
        """Return a version of a definition, by default the latest; raise `Problem` 404 if there is none."""
        versions = self._records.get(name)
        if not versions:
            known = ", ".join(sorted(self._records)) or "none yet"
            raise Problem(
                404,
                "No such definition",
                message(
                    "bpmn.no_such_definition",
                    'there is no definition "{name}"; deployed are: {known}',
                    name=name,
                    known=known,
                ),
            )
        if version is None:
            return versions[-1]
        if not 1 <= version <= len(versions):
            raise Problem(
                404,
                "No such version",
                message(
                    "bpmn.no_such_version",
                    '"{name}" has the versions 1 to {versions}, not {version}',
                    name=name,
                    versions=len(versions),
                    version=version,
                ),
            )
        return versions[version - 1]

    def plan(self, record: DefinitionRecord) -> Plan:
        """Return the executable plan of `record`; on the event loop, call `prepare` first."""
        if record.digest not in self._plans:
            self._plans[record.digest] = Plan(read_bpmn(record.xml))
        return self._plans[record.digest]

    async def prepare(self, record: DefinitionRecord) -> None:
        """Create the plan of `record` in a thread; the largest file takes half a second.

        A failure is not raised here: `plan` raises the reason.
        """
        if record.digest in self._plans:
            return
        with suppress(HandoverError):
            self._plans[record.digest] = await asyncio.to_thread(lambda: Plan(read_bpmn(record.xml)))

    def keep(self, plan: Plan) -> None:
        """Store a plan that exists already."""
        self._plans[_digest(plan.definition.xml)] = plan

    def next_version(
        self,
        definition: Definition,
        beside: Sequence[DefinitionRecord],
        now: datetime,
        *,
        only_if_never_seen: bool,
    ) -> tuple[DefinitionRecord, bool]:
        """Return the record that a deployment of `definition` results in, and whether it is new.

        `beside` are the records of other deployments in the same step.
        """
        versions = [
            *self._records.get(definition.name, []),
            *(r for r in beside if r.name == definition.name),
        ]
        digest = _digest(definition.xml)
        for record in versions if only_if_never_seen else versions[-1:]:
            if record.digest == digest:
                return record, False
        record = DefinitionRecord(
            name=definition.name,
            version=len(versions) + 1,
            digest=digest,
            title=definition.title,
            label=definition.label,
            xml=definition.xml,
            deployed_at=now,
        )
        return record, True

    def entities(self, record: DefinitionRecord) -> list[dict[str, Any]]:
        """Return the ProcessDefinition and TaskDefinitions of `record`."""
        url = f"{self._settings.own_url}/definitions/{record.name}/bpmn?version={record.version}"
        definition = self.plan(record).definition
        return definition_entities(self._settings, definition, record.version, url)


def plan_of(xml: bytes) -> Plan:
    """Return the plan for `xml`; raise `BadBpmn` if it is wrong or the engine cannot run it."""
    definition = read_bpmn(xml)
    try:
        return Plan(definition)
    except RunFailed as failure:
        raise BadBpmn([Fault(definition.name, None, text_of(failure))]) from failure


def read_runnable(xml: bytes) -> Definition:
    """Return the definition in `xml`; raise `BadBpmn` if it is wrong or the engine cannot run it."""
    return plan_of(xml).definition


def _digest(xml: bytes) -> str:
    return hashlib.sha256(xml).hexdigest()
