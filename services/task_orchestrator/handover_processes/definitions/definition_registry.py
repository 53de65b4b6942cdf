"""Definition registry: all versions of the deployed definitions; a running process keeps its version."""

import asyncio
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import chain
from typing import Any

from handover.errors import HandoverError, Problem
from handover.messages import text_of
from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.state import Library, RunFailed
from handover_bpmn.languages.base import quote_names
from handover_bpmn.model import Call, Definition, Fault
from handover_bpmn.notation.file import read_bpmn
from handover_processes.records.definitions import (
    EVERY_DEFINITION,
    DefinitionHold,
    DefinitionRecord,
    DeletedVersion,
    HoldKind,
)
from handover_processes.records.entities import definition_entities
from handover_processes.settings import OrchestratorSettings


@dataclass(frozen=True, slots=True)
class DeployedDefinition:
    """The result of a deployment; `created` is False when it changed nothing."""

    name: str
    version: int
    created: bool


@dataclass(frozen=True, slots=True)
class Deployed:
    """The results of the deployment of a file, one a process, and the warnings about it."""

    deployments: tuple[DeployedDefinition, ...]
    warnings: tuple[Fault, ...]

    @property
    def created(self) -> bool:
        """Return whether there is a new version of any process."""
        return any(deployment.created for deployment in self.deployments)


class DefinitionRegistry(Library):
    """All definitions by name and version."""

    def __init__(self, settings: OrchestratorSettings) -> None:
        self._settings = settings
        self._records: dict[str, list[DefinitionRecord]] = {}
        self._plans: dict[tuple[str, int], Plan] = {}
        self.holds: dict[tuple[str, HoldKind], DefinitionHold] = {}
        """What is withheld from definitions."""
        self._deleted: dict[str, dict[int, DeletedVersion]] = {}

    def add(self, records: Iterable[DefinitionRecord]) -> None:
        """Add `records`, in the order of their versions."""
        for record in records:
            self._records.setdefault(record.name, []).append(record)

    def add_deleted(self, deleted: Iterable[DeletedVersion]) -> None:
        """Add versions that nothing starts any more."""
        for version in deleted:
            self._deleted.setdefault(version.definition, {})[version.version] = version

    def deleted_versions(self, name: str) -> Mapping[int, DeletedVersion]:
        """Return the deleted versions of a definition."""
        return self._deleted.get(name, {})

    def first_deployed_at(self) -> datetime | None:
        """Return when the first definition was deployed; None without any."""
        records = chain.from_iterable(self._records.values())
        return min((record.deployed_at for record in records), default=None)

    def latest(self) -> list[DefinitionRecord]:
        """Return the latest version of each definition that is not deleted."""
        return [self._records[name][-1] for name in sorted(self._records) if not self._is_deleted(name)]

    def holds_of(self, name: str) -> list[DefinitionHold]:
        """Return what is withheld from a definition, or from every one."""
        keys = ((held, kind) for held in (name, EVERY_DEFINITION) for kind in HoldKind)
        return [self.holds[key] for key in keys if key in self.holds]

    def is_startable(self, name: str) -> bool:
        """Return whether processes of a definition may start: it is neither suspended nor deleted."""
        return all(hold.kind is HoldKind.PAUSED for hold in self.holds_of(name))

    def require_startable(self, name: str, version: int | None = None) -> None:
        """Raise `Problem` 409 if no process of a definition, or of this version of it, may start."""
        hold = next((hold_ for hold_ in self.holds_of(name) if hold_.kind is not HoldKind.PAUSED), None)
        if hold is not None:
            raise Problem.translated(
                409,
                "Definition is suspended",
                "process.definition_suspended",
                'no process of "{name}" starts: {by} has suspended or deleted it; activate or deploy it',
                name=name,
                by=hold.by,
            )
        deleted = None if version is None else self.deleted_versions(name).get(version)
        if deleted is not None:
            raise Problem.translated(
                409,
                "Version is deleted",
                "process.version_is_deleted",
                'no process of version {version} of "{name}" starts: {by} has deleted it; '
                "name another version",
                version=version,
                name=name,
                by=deleted.by,
            )

    def _is_deleted(self, name: str) -> bool:
        return (name, HoldKind.DELETED) in self.holds

    def record(self, name: str, version: int | None = None) -> DefinitionRecord:
        """Return a version of a definition, by default the latest; raise `Problem` 404 if there is none."""
        versions = self._records.get(name)
        if not versions or (version is None and self._is_deleted(name)):
            names = quote_names((record.name for record in self.latest()), near=name)
            raise Problem.translated(
                404,
                "No such definition",
                "bpmn.no_such_definition",
                'there is no definition "{name}"; deployed are: {known}',
                name=name,
                known=names,
            )
        if version is None:
            return versions[-1]
        if not 1 <= version <= len(versions):
            raise Problem.translated(
                404,
                "No such version",
                "bpmn.no_such_version",
                '"{name}" has the versions 1 to {versions}, not {version}',
                name=name,
                versions=len(versions),
                version=version,
            )
        return versions[version - 1]

    def calls_of(self, record: DefinitionRecord) -> list[tuple[str, Call]]:
        """Return the calls of a version, each with its element; none if this release cannot read it."""
        try:
            nodes = self.plan_of(record).definition.nodes()
        except HandoverError:
            return []
        return [(node.id, node.call) for node in nodes if node.call is not None]

    def is_called(self, call: Call, record: DefinitionRecord) -> bool:
        """Return whether a call always runs this version, by its number or its tag."""
        if call.process.literal != record.name:
            return False
        if call.version is not None and str(call.version.literal) == str(record.version):
            return True
        tag = None if call.tag is None else call.tag.literal
        return isinstance(tag, str) and self.tagged(record.name, tag) is record

    def plan_of(self, record: DefinitionRecord) -> Plan:
        """Return the executable plan of `record`; on the event loop, call `prepare` first.

        Raises `BadBpmn` if this release cannot execute it.
        """
        key = (record.name, record.version)
        if key not in self._plans:
            self._plans[key] = _read(record)
        return self._plans[key]

    def plan(self, name: str, version: int) -> Plan:
        """Return a version of a definition; raise `RunFailed` if there is none that can be executed."""
        try:
            return self.plan_of(self.record(name, version))
        except Problem as problem:
            raise RunFailed(text_of(problem)) from problem

    def find(self, name: str, version: int | None, tag: str | None) -> Plan:
        """Return the latest version, or that with the version number or tag; raise `RunFailed` if none."""
        try:
            self.require_startable(name, version)
        except Problem as problem:
            raise RunFailed(text_of(problem)) from problem
        if tag is None:
            try:
                return self.plan_of(self.record(name, version))
            except Problem as problem:
                raise RunFailed(text_of(problem)) from problem
        tagged = self.tagged(name, tag)
        if tagged is not None:
            return self.plan(name, tagged.version)
        raise RunFailed.translated(
            "bpmn.no_such_tag", '"{name}" has no version with the tag "{tag}"', name=name, tag=tag
        )

    def tagged(self, name: str, tag: str) -> DefinitionRecord | None:
        """Return the latest version with a tag that is not deleted."""
        deleted = self.deleted_versions(name)
        records = (
            version for version in reversed(self._records.get(name, [])) if version.version not in deleted
        )
        return next((version for version in records if version.label == tag), None)

    def deployed_at(self, name: str, version: int) -> datetime | None:
        """Return when a version was deployed."""
        return self.record(name, version).deployed_at

    async def prepare(self, record: DefinitionRecord) -> None:
        """Create the plan of `record` in a thread; the largest file takes half a second.

        A failure is not raised here: `plan_of` raises the reason.
        """
        key = (record.name, record.version)
        if key in self._plans:
            return
        with suppress(HandoverError):
            self._plans[key] = await asyncio.to_thread(_read, record)

    def keep(self, plan: Plan) -> None:
        """Store a plan that exists already."""
        self._plans[plan.definition.name, plan.version] = plan

    def next_version(
        self,
        definition: Definition,
        beside: Sequence[DefinitionRecord],
        now: datetime,
        *,
        only_if_never_seen: bool = False,
    ) -> tuple[DefinitionRecord, bool]:
        """Return the record that a deployment of `definition` results in, and whether it is new.

        `beside` are the records of other deployments in the same step.
        """
        versions = [
            *self._records.get(definition.name, []),
            *(r for r in beside if r.name == definition.name),
        ]
        digest = _digest(definition.xml)
        is_new = self._is_deleted(definition.name) and not only_if_never_seen
        for record in versions if only_if_never_seen else versions[-1:]:
            if record.digest == digest and not is_new:
                return record, False
        record = DefinitionRecord(
            name=definition.name,
            version=len(versions) + 1,
            digest=digest,
            title=definition.title,
            label=definition.label,
            xml=definition.xml,
            deployed_at=now,
            source=definition.source,
            is_event_driven=definition.is_event_driven,
        )
        return record, True

    def entity_id(self, name: str, version: int) -> str:
        """Return the id of the ProcessDefinition of a version."""
        return self.entity_id_of(self.record(name, version))

    def entity_id_of(self, record: DefinitionRecord) -> str:
        """Return the id of the ProcessDefinition of `record`: that of another system, or ours."""
        return record.source or self._settings.entity_id("ProcessDefinition", record.name)

    def entities(self, record: DefinitionRecord) -> list[dict[str, Any]]:
        """Return the ProcessDefinition and TaskDefinitions of `record` as this orchestrator writes them."""
        url = f"{self._settings.orchestrator}/definitions/{record.name}/bpmn?version={record.version}"
        definition = self.plan_of(record).definition
        return definition_entities(self._settings, definition, record.version, url)


def _read(record: DefinitionRecord) -> Plan:
    for definition in read_bpmn(record.xml, is_deployed=True).definitions:
        if definition.name == record.name:
            return Plan(replace(definition, source=record.source), record.version)
    raise RunFailed(f'the file of "{record.name}" has no such process')


def _digest(xml: bytes) -> str:
    return hashlib.sha256(xml).hexdigest()
