"""Process control: people start, pause, mend and cancel processes, and send them messages."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import timedelta
from typing import Any

import orjson

from handover.errors import Problem
from handover.messages import text_of
from handover_bpmn.execution.graph import Plan
from handover_bpmn.languages.native import is_name
from handover_processes.operations.start_forms import FormOfStart
from handover_processes.process import interventions
from handover_processes.process.interventions import MigrationReport
from handover_processes.process.process import Process
from handover_processes.records.messages import MessageOutcome
from handover_processes.records.processes import Act, ActKind
from handover_processes.records.step import Step
from handover_processes.steps.step_writer import StepWriter
from handover_processes.steps.working_state import WorkingState


class ProcessControl:
    """The requests of people about processes."""

    def __init__(self, state: WorkingState, writer: StepWriter) -> None:
        self._state = state
        self._writer = writer

    async def start(
        self,
        definition: str,
        parameters: Mapping[str, Any],
        *,
        version: int | None = None,
        key: str | None = None,
        request: str | None = None,
    ) -> tuple[str, bool]:
        """Start a process; return its id, and False if `key` or `request` had started it before.

        Raises `Problem` 404 for an unknown definition, 422 for parameters that do not fit it or its form.
        """
        state, registry = self._state, self._state.registry
        if key is not None and (running := await state.on_disk(state.store.by_key, key)) is not None:
            return running.id, False
        process_id = None if request is None else f"{definition}-{request}"
        if process_id is not None and await state.on_disk(state.store.processes, [process_id]):
            return process_id, False
        check_variables(parameters)
        with suppress(Problem):  # a process that `key` started meanwhile is returned, whatever its definition
            await registry.prepare(registry.record(definition, version))

        def act(step: Step) -> tuple[str, bool]:
            earlier = None if key is None else state.active_processes.with_key(key)
            if earlier is not None:
                return earlier.record.id, False
            if process_id is not None and process_id in state.active_processes.processes:
                return process_id, False
            deployed = registry.record(definition, version)
            plan = registry.plan_of(deployed)
            form = FormOfStart(plan.definition, state.allocator.forms, deployed.deployed_at, state.clock())
            variables = form.arguments(parameters)
            return state.start(step, deployed, variables, key=key, process_id=process_id), True

        return await self._writer.apply(act)

    async def cancel(self, process_id: str, by: str | None = None) -> None:
        """Cancel a process; raise `Problem` 404 if there is none, 409 if it has ended."""
        await self._writer.apply_to(
            process_id,
            lambda process, step: interventions.cancel(process, by, step, self._state.clock()),
            is_lowering=True,
        )

    async def retry(self, process_id: str, task_id: str, by: str) -> None:
        """Post a failed Task again that its process waits for.

        Raises `Problem` 404 if there is no such process or Task, 409 if it cannot be retried.
        """

        def act(process: Process, step: Step) -> None:
            token, now = interventions.incident_of(process, task_id), self._state.clock()
            interventions.mend(process, Act(now, ActKind.RETRY, by, task_id), token, step, now)

        await self._writer.apply_to(process_id, act)

    async def mend(
        self,
        process_id: str,
        kind: ActKind,
        token: str | None,
        *,
        by: str | None,
        why: str | None,
        to: str | None = None,
        values: Mapping[str, Any] | None = None,
        scope: str | None = None,
    ) -> None:
        """Do what a person has decided about a token of a process, or about its variables.

        With `scope` the variables are those of an inner scope.

        Raises `Problem` 404 if there is no such process or token, 409 if the act is impossible.
        """

        def act(process: Process, step: Step) -> None:
            now = self._state.clock()
            decided = Act(now, kind, by, to=to, why=why, values=dict(values) if values else None)
            interventions.mend(process, decided, token, step, now, scope=scope)

        await self._writer.apply_to(process_id, act)

    async def release(self, process_id: str, key: str, *, by: str | None, why: str | None) -> None:
        """Release a reservation; raise `Problem` 404 if there is none, 409 if it is not held."""

        def act(process: Process, step: Step) -> None:
            now = self._state.clock()
            interventions.release_reservation(process, Act(now, ActKind.RELEASE, by, why=why), key, step, now)

        await self._writer.apply_to(process_id, act)

    async def pause(self, process_id: str, kind: ActKind, *, by: str | None, why: str | None) -> None:
        """Pause or resume a process; raise `Problem` 404 if there is none, 409 if it has ended."""
        await self._writer.apply_to(
            process_id,
            lambda process, step: self._pause(process, kind, by, why, step),
            is_lowering=kind is ActKind.PAUSE,
        )

    async def pause_all(
        self, kind: ActKind, *, by: str | None, why: str | None, definition: str | None = None
    ) -> list[str]:
        """Pause or resume all running processes, or those of a definition; return their ids."""

        def pausing(process: Process) -> Callable[[Step], None]:
            return lambda step: self._pause(process, kind, by, why, step)

        wanted = {
            process.record.id: pausing(process)
            for process in self._state.active_processes.processes.values()
            if process.run is not None and definition in (None, process.record.definition)
        }
        return list(await self._writer.apply_each(wanted, is_lowering=kind is ActKind.PAUSE))

    async def migrate(
        self, process_id: str, version: int | None, act: Act, *, dry: bool = False
    ) -> MigrationReport:
        """Continue a process in another version, by default the latest; with `dry` only report what differs.

        Raises `Problem` 404 if there is no such process or version, 409 if it has ended or has that version.
        """
        record = await self._state.require_process(process_id)
        plan = await self._plan(record.definition, version)
        return await self._writer.apply_to(
            process_id,
            lambda process, step: interventions.migrate(
                process, plan, act, step, self._state.clock(), dry=dry
            ),
        )

    async def migrate_all(
        self, definition: str, source: int, version: int | None, act: Act, *, dry: bool = False
    ) -> tuple[int, list[MigrationReport]]:
        """Migrate the running processes of the version `source`, each if it is possible for it.

        Returns the version that they are migrated to, and their reports.
        """
        plan = await self._plan(definition, version)
        if plan.version == source:
            raise Problem.translated(
                422,
                "Same version",
                "process.same_version",
                "the processes of version {version} cannot be migrated to the same version",
                version=source,
            )

        def migrating(process: Process) -> Callable[[Step], MigrationReport]:
            return lambda step: interventions.migrate(process, plan, act, step, self._state.clock(), dry=dry)

        wanted = {
            process.record.id: migrating(process)
            for process in self._state.active_processes.processes.values()
            if process.run is not None
            and (process.record.definition, process.record.version) == (definition, source)
        }
        reports = await self._writer.apply_each(wanted)
        return plan.version, list(reports.values())

    async def _plan(self, definition: str, version: int | None) -> Plan:
        record = self._state.registry.record(definition, version)
        if version is not None:
            self._state.registry.require_startable(definition, version)
        await self._state.registry.prepare(record)
        return self._state.registry.plan_of(record)

    async def publish(
        self,
        name: str,
        *,
        key: Any = None,
        process: str | None = None,
        variables: Mapping[str, Any],
        ttl: timedelta | None = None,
    ) -> tuple[MessageOutcome, str | None]:
        """Bring a message to the process that waits for it, or start one; otherwise keep it for `ttl`.

        With `process` no other process gets it, and it starts none. Returns what became of it, and the
        process. Raises `Problem` 409 if several processes wait for it or `process` has ended, 404 if there is
        no such process.
        """
        events = self._state.events

        def act(step: Step) -> tuple[MessageOutcome, str | None]:
            now = self._state.clock()
            record = events.record(name, key, variables, now, ttl=ttl, process=process)
            return events.publish(step, record, now)

        def act_for(addressee: Process, step: Step) -> tuple[MessageOutcome, str | None]:
            addressee.require_running()
            return act(step)

        if process is None:
            return await self._writer.apply(act)
        return await self._writer.apply_to(process, act_for)

    async def broadcast(self, name: str, variables: Mapping[str, Any]) -> list[str]:
        """Bring a signal to everyone who waits for it; return the processes that got it or were started."""
        state = self._state
        return await self._writer.apply(
            lambda step: state.events.broadcast(step, name, variables, state.clock())
        )

    def _pause(self, process: Process, kind: ActKind, by: str | None, why: str | None, step: Step) -> None:
        now = self._state.clock()
        act = Act(now, kind, by, why=why)
        if kind is ActKind.PAUSE:
            interventions.pause(process, act, step, now)
        else:
            interventions.resume_work(process, act, step, now)


def check_variables(variables: Mapping[str, Any]) -> None:
    """Raise `Problem` 422 for names or values that process variables cannot have."""
    for name in variables:
        if not is_name(name):
            raise Problem.translated(
                422,
                "Bad parameter",
                "process.bad_parameter_name",
                '"{name}" cannot be the name of a process variable',
                name=name,
            )
    try:
        orjson.dumps(variables)
    except TypeError as error:
        raise Problem.translated(
            422,
            "Bad parameter",
            "process.parameters_not_json",
            "the parameters are no plain JSON: {error}",
            error=text_of(error),
        ) from None
