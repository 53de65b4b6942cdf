"""Holds of definitions: people pause, suspend, activate and delete definitions."""

from handover.errors import Problem
from handover.messages import message
from handover_bpmn.languages.base import quote_names
from handover_processes.records.definitions import (
    EVERY_DEFINITION,
    DefinitionHold,
    DefinitionRecord,
    DeletedVersion,
    HoldKind,
)
from handover_processes.records.messages import MessageKind
from handover_processes.records.step import Step
from handover_processes.steps.step_writer import StepWriter
from handover_processes.steps.working_state import WorkingState


class DefinitionHolds:
    """The requests of people about definitions; each is stored when it is answered."""

    def __init__(self, state: WorkingState, writer: StepWriter) -> None:
        self._state = state
        self._writer = writer

    async def pause_starts(self, definition: str | None, by: str, why: str | None) -> None:
        """Let the timer start events of a definition wait, or of all definitions."""
        hold = self._hold(definition or EVERY_DEFINITION, HoldKind.PAUSED, by, why)
        await self._writer.apply(lambda step: self._begin(step, hold), is_lowering=True)

    async def resume_starts(self, definition: str | None) -> None:
        """Let the timer start events of a definition continue, or of all definitions."""

        def act(step: Step) -> None:
            paused = (name for name, kind in self._state.registry.holds if kind is HoldKind.PAUSED)
            for name in list(paused) if definition is None else [definition]:
                step.holds[name, HoldKind.PAUSED] = None

        await self._writer.apply(act)

    async def suspend(self, definition: str, by: str, why: str | None) -> None:
        """Let no process of a definition start; those that run continue.

        Raises `Problem` 404 for an unknown definition.
        """
        self._state.registry.record(definition)
        hold = self._hold(definition, HoldKind.SUSPENDED, by, why)
        await self._writer.apply(lambda step: self._begin(step, hold), is_lowering=True)

    async def activate(self, definition: str) -> None:
        """Let processes of a suspended definition start; stored messages to its start events start some.

        Raises `Problem` 404 for an unknown definition.
        """
        self._state.registry.record(definition)
        if (definition, HoldKind.SUSPENDED) not in self._state.registry.holds:
            return

        def act(step: Step) -> None:
            step.holds[definition, HoldKind.SUSPENDED] = None

        def start_stored(step: Step) -> None:
            if self._state.registry.is_startable(definition):
                self._state.events.start_stored(step, definition)

        await self._writer.apply(act)
        await self._writer.apply(start_stored)

    async def delete(self, definition: str, by: str, why: str | None) -> None:
        """Delete a definition with all versions; processes of it that have ended can still be read.

        Raises `Problem` 404 for an unknown definition, 409 while processes of it run.
        """
        registry = self._state.registry

        def act(step: Step) -> None:
            record = registry.record(definition)
            processes = self._state.active_processes.processes.values()
            running = sum(
                process.run is not None and process.record.definition == definition for process in processes
            )
            if running:
                raise Problem.translated(
                    409,
                    "Processes run",
                    "process.definition_runs",
                    '{count} processes of "{name}" run; cancel them, or suspend it until they have ended',
                    count=running,
                    name=definition,
                )
            self._begin(step, self._hold(definition, HoldKind.DELETED, by, why))
            step.holds[definition, HoldKind.SUSPENDED] = step.holds[definition, HoldKind.PAUSED] = None
            step.start_timers[definition] = ()
            if record.source is None:
                entity = registry.entity_id_of(record)
                step.enqueue(f"definition {definition}", MessageKind.DELETE, entity, [entity])

        await self._writer.apply(act)

    async def delete_version(self, definition: str, version: int, by: str, why: str | None) -> None:
        """Delete an earlier version of a definition; processes of it that have ended can still be read.

        Raises `Problem` 404 for an unknown one, 409 while processes of it run or others need it.
        """
        registry = self._state.registry
        registry.record(definition, version)
        for record in self._callers():
            await registry.prepare(record)

        def act(step: Step) -> None:
            record = registry.record(definition, version)
            if version in registry.deleted_versions(definition):
                return
            if record is registry.record(definition):
                raise _needed(
                    message(
                        "process.version_is_latest",
                        'version {version} is the latest of "{name}", which calls, timers, messages and '
                        "people start; deploy the file that follows it before, or delete the definition",
                        version=version,
                        name=definition,
                    )
                )
            names = [
                process.record.id
                for process in self._state.active_processes.processes.values()
                if process.run is not None and (definition, version) in process.run.versions()
            ]
            if names:
                raise _needed(
                    message(
                        "process.version_runs",
                        '{processes} run version {version} of "{name}"; cancel or migrate them, or wait '
                        "until they have ended",
                        processes=quote_names(names),
                        version=version,
                        name=definition,
                    )
                )
            for caller in self._callers():
                for element, call in registry.calls_of(caller):
                    if registry.is_called(call, record):
                        raise _needed(
                            message(
                                "process.version_is_called",
                                '"{caller}" (version {its_version}) calls version {version} of "{name}" at '
                                '"{element}"; deploy a version of it that calls another',
                                caller=caller.name,
                                its_version=caller.version,
                                version=version,
                                name=definition,
                                element=element,
                            )
                        )
            deleted = DeletedVersion(definition, version, by, why, self._state.clock(), step.is_verified(by))
            step.deleted_versions.append(deleted)

        await self._writer.apply(act)

    def _callers(self) -> list[DefinitionRecord]:
        """Return the versions whose processes may call others: the latest ones, and those that run."""
        registry = self._state.registry
        latest = {(record.name, record.version): record for record in registry.latest()}
        for process in self._state.active_processes.processes.values():
            for key in process.run.versions() if process.run is not None else ():
                latest.setdefault(key, registry.record(*key))
        return list(latest.values())

    def _hold(self, definition: str, kind: HoldKind, by: str, why: str | None) -> DefinitionHold:
        return DefinitionHold(definition, kind, by, why, self._state.clock())

    def _begin(self, step: Step, hold: DefinitionHold) -> None:
        """Begin a hold; one that is there stays, with the person who has begun it."""
        key = (hold.definition, hold.kind)
        if key not in self._state.registry.holds:
            verified = step.is_verified(hold.by)
            step.holds[key] = DefinitionHold(*key, hold.by, hold.why, hold.at, verified)


def _needed(why: str) -> Problem:
    return Problem(409, "Version is needed", why)
