"""Deployments: definitions that people deploy, and the mapping of their names to performers."""

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from handover.errors import Problem
from handover.messages import message
from services.task_orchestrator.allocation.mapping import MappingEntry, MappingTable
from services.task_orchestrator.definition_registry import Deployed, Deployment
from services.task_orchestrator.execution.graph import Plan
from services.task_orchestrator.notation.faults import as_json
from services.task_orchestrator.notation.file import BpmnFile, read_bpmn
from services.task_orchestrator.records import MessageKind, Step
from services.task_orchestrator.start_timers import start_timers
from services.task_orchestrator.step_writer import StepWriter
from services.task_orchestrator.working_state import WorkingState


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
        file = await asyncio.to_thread(read_bpmn, xml)

        def act(step: Step) -> Deployed:
            return deploy_into(step, self._state, file, only_if_never_seen=only_if_never_seen)

        return await self._writer.apply(act)

    async def check(self, xml: bytes) -> dict[str, Any]:
        """Return the result that a deployment would have; raise `BadBpmn` if the file cannot be executed."""
        file = await asyncio.to_thread(read_bpmn, xml)
        found = []
        for definition in file.definitions:
            record, created = self._state.registry.next_version(
                definition, (), self._state.clock(), only_if_never_seen=False
            )
            found.append(
                {"name": record.name, "version": record.version, "title": record.title, "created": created}
            )
        allocation = [line for each in file.definitions for line in self._state.allocator.report(each)]
        warnings = as_json(file.warnings)
        return {**found[0], "definitions": found, "warnings": warnings, "allocation": allocation}

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
            present = step.mappings[-1] if step.mappings else self._state.allocator.mapping
            if version not in {None, present.version}:
                raise Problem(
                    409,
                    "Mapping has changed",
                    message(
                        "allocation.mapping_changed",
                        "the mapping has the version {present}, not {version}; read it and change it again",
                        present=present.version,
                        version=version,
                    ),
                )
            table = MappingTable(present.version + 1, tuple(entries), by, why, self._state.clock())
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
    found = []
    for each in file.definitions:
        definition = replace(each, source=source)
        record, created = registry.next_version(
            definition, step.definitions, now, only_if_never_seen=only_if_never_seen
        )
        if created:
            registry.keep(Plan(definition, record.version))
            step.definitions.append(record)
            step.start_timers[record.name] = start_timers(definition, now)
            entities = registry.entities(record)
            if entities:
                subject = registry.entity_id_of(record)
                step.enqueue(f"definition {record.name}", MessageKind.DEFINE, subject, entities)
        found.append(Deployment(record.name, record.version, created))
    return Deployed(tuple(found), file.warnings)
