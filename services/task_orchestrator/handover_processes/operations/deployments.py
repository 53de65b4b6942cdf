"""Deployments: definitions that people deploy, and the mapping of their names to performers."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import PurePath
from typing import Any

from handover.errors import Problem
from handover.messages import Message
from handover_bpmn.execution.graph import Plan
from handover_bpmn.forms.form_js import FormFile, read_form
from handover_bpmn.notation.faults import as_json
from handover_bpmn.notation.file import BpmnFile, read_bpmn
from handover_processes.allocation.mapping import MappingEntry, MappingTable
from handover_processes.allocation.report import allocation_report
from handover_processes.definitions.definition_registry import Deployed, DeployedDefinition
from handover_processes.definitions.start_timers import start_timers
from handover_processes.deployed_forms import FormRecord
from handover_processes.records.definitions import HoldKind
from handover_processes.records.messages import MessageKind
from handover_processes.records.step import Step
from handover_processes.steps.step_writer import StepWriter
from handover_processes.steps.working_state import WorkingState


@dataclass(frozen=True, slots=True)
class DeployedForm:
    """The result of the deployment of a form; `created` is False when it changed nothing."""

    record: FormRecord
    created: bool
    warnings: tuple[Message, ...]


@dataclass(frozen=True, slots=True)
class DeploymentResult:
    """The results of a deployment of several files."""

    bpmn: Deployed
    forms: tuple[DeployedForm, ...]

    @property
    def created(self) -> bool:
        """Return whether there is a new version of anything."""
        return self.bpmn.created or any(form.created for form in self.forms)


class Deployments:
    """Deploys BPMN files and replaces the mapping."""

    def __init__(self, state: WorkingState, writer: StepWriter) -> None:
        self._state = state
        self._writer = writer

    async def deploy(self, xml: bytes, *, only_if_never_seen: bool = False) -> Deployed:
        """Deploy the processes of a BPMN file; raise `BadBpmn` if one cannot be executed.

        A process whose file equals its latest version, or with `only_if_never_seen` any version, stays as it
        is.
        """
        deployed = await self.deploy_files([xml], [], only_if_never_seen=only_if_never_seen)
        return deployed.bpmn

    async def deploy_files(
        self,
        bpmn: Sequence[bytes],
        forms: Sequence[tuple[str | None, bytes]],
        *,
        only_if_never_seen: bool = False,
    ) -> DeploymentResult:
        """Deploy BPMN files and forms (each with the name of its file) together: all or none.

        Raises `BadBpmn` or `BadForm` if one of them cannot be deployed.
        """
        files = [await asyncio.to_thread(read_bpmn, xml) for xml in bpmn]
        read = [
            (await asyncio.to_thread(read_form, content, _stem(name)), content, name)
            for name, content in forms
        ]

        def act(step: Step) -> DeploymentResult:
            now = self._state.clock()
            written = [self._deploy_form(form, content, name, step, now) for form, content, name in read]
            results = [
                deploy_into(step, self._state, file, only_if_never_seen=only_if_never_seen) for file in files
            ]
            deployments = tuple(deployment for deployed in results for deployment in deployed.deployments)
            warnings = tuple(warning for deployed in results for warning in deployed.warnings)
            return DeploymentResult(Deployed(deployments, warnings), tuple(written))

        return await self._writer.apply(act)

    def _deploy_form(
        self, form: FormFile, content: bytes, name: str | None, step: Step, now: datetime
    ) -> DeployedForm:
        forms = self._state.allocator.forms
        record, created = forms.next_version(form, content, name, step.forms, now)
        if created:
            step.forms.append(record)
        return DeployedForm(record, created, form.warnings)

    async def check(self, xml: bytes) -> dict[str, Any]:
        """Return the result that a deployment would have; raise `BadBpmn` if the file cannot be executed."""
        file = await asyncio.to_thread(read_bpmn, xml)
        results = []
        for definition in file.definitions:
            record, created = self._state.registry.next_version(
                definition, (), self._state.clock(), only_if_never_seen=False
            )
            results.append(
                {"name": record.name, "version": record.version, "title": record.title, "created": created}
            )
        allocation = [
            line
            for read_definition in file.definitions
            for line in allocation_report(
                self._state.allocator.rules, self._state.allocator.forms, read_definition
            )
        ]
        warnings = as_json(file.warnings)
        return {**results[0], "definitions": results, "warnings": warnings, "allocation": allocation}

    async def set_mapping(
        self,
        entries: Sequence[MappingEntry],
        *,
        by: str | None,
        why: str | None = None,
        version: int | None = None,
    ) -> MappingTable:
        """Replace the mapping, for Tasks that are posted from now on.

        Raises `Problem` 409 if `version` is given and is not the present one.
        """

        def act(step: Step) -> MappingTable:
            present = step.mappings[-1] if step.mappings else self._state.allocator.rules.mapping
            if version not in {None, present.version}:
                raise Problem.translated(
                    409,
                    "Mapping has changed",
                    "allocation.mapping_changed",
                    "the mapping has the version {present}, not {version}; read it and change it again",
                    present=present.version,
                    version=version,
                )
            now, verified = self._state.clock(), step.is_verified(by)
            table = MappingTable(present.version + 1, tuple(entries), by, why, now, verified)
            step.mappings.append(table)
            return table

        return await self._writer.apply(act)


def deploy_into(
    step: Step,
    state: WorkingState,
    file: BpmnFile,
    *,
    only_if_never_seen: bool = False,
    source: str | None = None,
) -> Deployed:
    """Deploy the processes of a file in a step; `source` is the entity of another system that it is of."""
    registry, now = state.registry, state.clock()
    deployments = []
    for read_definition in file.definitions:
        definition = replace(read_definition, source=source)
        record, created = registry.next_version(
            definition, step.definitions, now, only_if_never_seen=only_if_never_seen
        )
        if created:
            registry.keep(Plan(definition, record.version))
            step.definitions.append(record)
            step.holds[record.name, HoldKind.DELETED] = None
            step.start_timers[record.name] = start_timers(definition, now)
            entities = registry.entities(record)
            if entities:
                subject = registry.entity_id_of(record)
                step.enqueue(f"definition {record.name}", MessageKind.DEFINE, subject, entities)
        deployments.append(DeployedDefinition(record.name, record.version, created))
    return Deployed(tuple(deployments), file.warnings)


def _stem(name: str | None) -> str | None:
    return None if name is None else PurePath(name).stem
