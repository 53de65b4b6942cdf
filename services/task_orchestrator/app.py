"""REST interface: deploy definitions; start, read, cancel and retry processes; receive notifications."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, timedelta
from pathlib import Path
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request, Response
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field
from starlette.responses import JSONResponse

from datamodels.entities import TaskStatus
from handover.body_limit import max_body
from handover.broker import BrokerClient
from handover.durations import parse_duration
from handover.errors import Problem, UsageError
from handover.messages import message
from handover.service import XML_TYPES, accepts, create_app
from handover.storage import storage_check
from handover.telemetry import get_logger
from services.task_orchestrator.allocation.mapping import MappingRequest, read_mapping_file
from services.task_orchestrator.archive import Archiver
from services.task_orchestrator.entity_events import EntityEvents
from services.task_orchestrator.model import Fault
from services.task_orchestrator.notation.document import MAX_BYTES
from services.task_orchestrator.notation.faults import BadBpmn, as_json
from services.task_orchestrator.operations.process_control import check_variables
from services.task_orchestrator.orchestrator import Orchestrator
from services.task_orchestrator.reconcile import Reconciler
from services.task_orchestrator.records import ActKind
from services.task_orchestrator.responses import (
    AgentView,
    DefinitionView,
    DefinitionWithActivities,
    Deployment,
    DeploymentCheck,
    MappingView,
    PausedProcesses,
    PeriodStatistics,
    ProcessSummary,
    ProcessView,
    SentMessage,
    SentSignal,
    VersionStatistics,
    json_response,
)
from services.task_orchestrator.settings import OrchestratorSettings
from services.task_orchestrator.views import (
    activity_views,
    agent_views,
    definition_view,
    mapping_view,
    period_view,
    process_summary,
    process_view,
    statistics_view,
)

log = get_logger(__name__)

MAX_PARAMETERS_BYTES = 1024 * 1024
MAX_MAPPING_BYTES = 4 * 1024 * 1024
MAX_VERSION = 2**31 - 1
PROCESS: dict[int | str, dict[str, Any]] = {200: {"model": ProcessView}}
"""The response of the routes that return a process, for the OpenAPI document."""
SHIPPED = Path(__file__).parent / "processes"


class ProcessStart(BaseModel):
    """A request to start a process."""

    model_config = ConfigDict(extra="forbid")

    definition: str = Field(description="the name of a deployed definition")
    version: int | None = Field(None, description="a version of it; the latest if absent")
    parameters: dict[str, Any] = Field(default_factory=dict, description="its parameters")
    key: str | None = Field(
        None, pattern=r"^[^\x00]{1,200}$", description="a second request with the same key starts no process"
    )


Name = Annotated[str, Field(pattern=r"^[^\x00]*[^\x00\s][^\x00]*$", max_length=200)]


class CancelRequest(BaseModel):
    """A request to cancel a process."""

    model_config = ConfigDict(extra="forbid")

    by: Name | None = Field(None, description="the person who cancels it")


class RetryRequest(BaseModel):
    """A request to retry a failed Task."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the person who retries it")


class MendRequest(BaseModel):
    """What a person decides about a token of a process."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the person who decides; nobody verifies the name yet")
    why: str | None = Field(None, max_length=1000, description="the reason, for the history")
    variables: dict[str, Any] = Field(default_factory=dict, description="variables that are set before")


class PauseRequest(BaseModel):
    """A request to pause or resume processes."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the person who decides; nobody verifies the name yet")
    why: str | None = Field(None, max_length=1000, description="the reason, for the history")


class MessageRequest(BaseModel):
    """A message to a process."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(min_length=1, max_length=200, description="the name of the BPMN message")
    key: str | int | float | bool | None = Field(
        None, description="the correlation key, or the business key of the process"
    )
    process: str | None = Field(None, description="the id of the process that gets it")
    variables: dict[str, Any] = Field(default_factory=dict, description="variables that it brings")
    ttl: str | None = Field(
        None, description="how long it is kept while no process waits for it, such as PT10M; PT0S: not at all"
    )


class SignalRequest(BaseModel):
    """A signal to all processes."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(min_length=1, max_length=200, description="the name of the BPMN signal")
    variables: dict[str, Any] = Field(default_factory=dict, description="variables that it brings")


class MoveRequest(MendRequest):
    """A request to move a token."""

    to: str = Field(max_length=1000, description="the id of the element of the same scope to move it to")


class Components:
    """The components of the service; the routes share them."""

    def __init__(self, settings: OrchestratorSettings) -> None:
        self.settings = settings
        self.broker = BrokerClient(settings)
        self.orchestrator = Orchestrator(settings, self.broker)
        self.reconciler = Reconciler(self.orchestrator, self.broker)
        self.archiver = Archiver(self.orchestrator, self.broker)
        self.entity_events = EntityEvents(self.orchestrator, self.broker)

    def plain_id(self, process_id: str) -> str:
        """Return the id of a process, which may be given as its URN."""
        return process_id.removeprefix(self.settings.entity_id("Process", ""))

    @asynccontextmanager
    async def lifespan(self, _: FastAPI) -> AsyncIterator[None]:
        """Deploy the definitions of the folders and run until the service ends."""
        async with self.broker, self.orchestrator:
            if self.settings.mapping_file is not None:
                await self._load_mapping(self.settings.mapping_file)
            await self._deploy_folder(SHIPPED)
            if self.settings.process_dir is not None:
                await self._deploy_folder(self.settings.process_dir)
            async with self.reconciler, self.archiver, self.entity_events:
                yield

    async def _load_mapping(self, file: Path) -> None:
        """Store the mapping of a file if there is none yet."""
        if self.orchestrator.state.allocator.mapping.version:
            return
        try:
            read = read_mapping_file(await asyncio.to_thread(file.read_text, encoding="utf-8"))
        except (OSError, UnicodeDecodeError, UsageError) as error:
            log.warning("mapping file not read", file=str(file), error=str(error))
            return
        await self.orchestrator.deployments.set_mapping(read.entries, by=read.by, why=read.why)
        log.info("mapping stored", file=str(file), entries=len(read.entries), confirmed_by=read.by)

    async def _deploy_folder(self, folder: Path) -> None:
        if not await asyncio.to_thread(folder.is_dir):
            log.warning("folder of BPMN files not found", folder=str(folder))
        for file in await asyncio.to_thread(lambda: sorted(folder.glob("*.bpmn"))):
            try:
                xml = await asyncio.to_thread(file.read_bytes)
                deployed = await self.orchestrator.deployments.deploy(xml, only_if_never_seen=True)
            except BadBpmn as bad:
                faults = [str(fault) for fault in bad.faults]
                log.warning("BPMN file not deployed", file=str(file), faults=faults)
            except OSError as error:
                log.warning("BPMN file not readable", file=str(file), error=str(error))
            else:
                for each in deployed.deployments:
                    log.info("definition deployed", name=each.name, version=each.version)

    async def check_database(self) -> None:
        """Raise an exception if the database does not answer."""
        await self.orchestrator.on_disk(self.orchestrator.store.probe)


def make_only_app(settings: OrchestratorSettings) -> FastAPI:
    """Return the application; wait as a standby while another orchestrator writes the database."""
    at = Components(settings)
    lock = at.orchestrator.store.lock
    if not lock.acquire():
        log.info("standby: another orchestrator writes the database; this one takes over when that one ends")
        lock.wait()
    return _app(at)


def make_app(settings: OrchestratorSettings) -> FastAPI:
    """Return the application; its lifespan opens the connections."""
    return _app(Components(settings))


def _app(at: Components) -> FastAPI:
    settings = at.settings
    app = create_app(
        "Task orchestrator",
        description="Runs BPMN processes: each activity becomes a Task for a person or a robot.",
        lifespan=at.lifespan,
        checks={
            "database": at.check_database,
            "broker": at.broker.probe,
            "subscription": at.reconciler.probe,
            "storage": storage_check(settings.data_dir),
        },
    )
    _add_definitions(app, at.orchestrator)
    _add_processes(app, at)
    _add_interventions(app, at)
    _add_mapping(app, at.orchestrator)

    @app.post("/messages", tags=["events"], responses={200: {"model": SentMessage}})
    @max_body(MAX_PARAMETERS_BYTES)
    async def publish(body: MessageRequest) -> Response:
        """Send a message: to the process that waits for it, else a start event, else it is kept."""
        check_variables(body.variables)
        try:
            ttl = None if body.ttl is None else timedelta(seconds=parse_duration(body.ttl).nominal_s)
        except ValueError as error:
            raise Problem(422, "Bad time to live", str(error)) from error
        process = None if body.process is None else at.plain_id(body.process)
        outcome, reached = await at.orchestrator.processes.publish(
            body.name, key=body.key, process=process, variables=body.variables, ttl=ttl
        )
        return json_response({"outcome": outcome.value, "process": reached})

    @app.post("/signals", tags=["events"], responses={200: {"model": SentSignal}})
    @max_body(MAX_PARAMETERS_BYTES)
    async def broadcast(body: SignalRequest) -> Response:
        """Send a signal to every process that waits for it, and to start events."""
        check_variables(body.variables)
        return json_response(
            {"processes": await at.orchestrator.processes.broadcast(body.name, body.variables)}
        )

    @app.post("/notifications", status_code=204, tags=["notifications"])
    async def notify(request: Request) -> Response:
        """Read the changed Tasks from the broker; the response is sent when their changes are stored."""
        await at.reconciler.receive_notification(request)
        return Response(status_code=204)

    @app.post("/notifications/entities/{filter_key}", status_code=204, tags=["notifications"])
    async def notify_entities(filter_key: str, request: Request) -> Response:
        """Deliver the changed entities of a filter; the response is sent when the consequences are stored."""
        await at.entity_events.receive_notification(filter_key, request)
        return Response(status_code=204)

    return app


def _add_definitions(app: FastAPI, orchestrator: Orchestrator) -> None:
    registry = orchestrator.state.registry

    @app.post(
        "/definitions",
        status_code=201,
        tags=["definitions"],
        responses={201: {"model": Deployment}, 200: {"model": Deployment | DeploymentCheck}},
    )
    @accepts(*XML_TYPES)
    @max_body(2 * MAX_BYTES)
    async def deploy(request: Request, *, dry: bool = False) -> JSONResponse:
        """Deploy a BPMN file (the body is the XML): 201 for a new version, 200 if it is deployed already.

        With `dry` nothing is deployed: 200 with the version that the deployment would have.
        """
        body = await _body(request)
        if dry:
            return JSONResponse(await orchestrator.deployments.check(body), 200)
        deployed = await orchestrator.deployments.deploy(body)
        views = [
            definition_view(registry, registry.record(each.name, each.version))
            for each in deployed.deployments
        ]
        allocation = [
            line
            for each in deployed.deployments
            for line in orchestrator.state.allocator.report(
                registry.plan_of(registry.record(each.name, each.version)).definition
            )
        ]
        warnings = as_json(deployed.warnings)
        view = {**views[0], "definitions": views, "warnings": warnings, "allocation": allocation}
        return JSONResponse(view, 201 if deployed.created else 200)

    @app.get("/definitions", tags=["definitions"], responses={200: {"model": list[DefinitionView]}})
    async def definitions() -> Response:
        """Return the latest version of every definition."""
        latest = registry.latest()
        for record in latest:
            await registry.prepare(record)
        return json_response([definition_view(registry, record) for record in latest])

    @app.get(
        "/definitions/{name}", tags=["definitions"], responses={200: {"model": DefinitionWithActivities}}
    )
    async def definition(name: str, version: int | None = None) -> Response:
        """Return a definition with its activities."""
        record = registry.record(name, version)
        await registry.prepare(record)
        activities = activity_views(registry.plan_of(record).definition)
        return json_response({**definition_view(registry, record), "activities": activities})

    @app.get(
        "/definitions/{name}/statistics",
        tags=["definitions"],
        responses={200: {"model": VersionStatistics}},
    )
    async def statistics(name: str, version: int | None = None) -> Response:
        """Return the statistics of all processes of a version (default: the latest), by activity."""
        record = registry.record(name, version)
        counts = await orchestrator.on_disk(orchestrator.store.counts, record.name, record.version)
        return json_response(statistics_view(record, counts))

    @app.get("/definitions/{name}/bpmn", tags=["definitions"])
    async def bpmn(name: str, version: int | None = None) -> Response:
        """Return the BPMN file as it was deployed."""
        return Response(registry.record(name, version).xml, media_type="application/xml")


def _add_mapping(app: FastAPI, orchestrator: Orchestrator) -> None:
    @app.get("/mapping", tags=["allocation"], responses={200: {"model": MappingView}})
    async def mapping(
        version: Annotated[int | None, Query(ge=1, le=MAX_VERSION)] = None,
    ) -> Response:
        """Return the mapping from names in process files to performers, or an earlier version of it."""
        if version is None:
            return json_response(mapping_view(orchestrator.state.allocator.mapping))
        table = await orchestrator.on_disk(orchestrator.store.mapping, version)
        if table is None:
            raise Problem(
                404,
                "No such version",
                message(
                    "allocation.no_such_mapping",
                    "there is no version {version} of the mapping; the latest is {latest}",
                    version=version,
                    latest=orchestrator.state.allocator.mapping.version,
                ),
            )
        return json_response(mapping_view(table))

    @app.get("/agents", tags=["allocation"], responses={200: {"model": list[AgentView]}})
    async def agents() -> Response:
        """Return the Devices and Persons that can perform Tasks, with their skills and open Tasks."""
        return json_response(agent_views(orchestrator.state.allocator))

    @app.put("/mapping", tags=["allocation"], responses={200: {"model": MappingView}})
    @max_body(MAX_MAPPING_BYTES)
    async def set_mapping(body: MappingRequest) -> Response:
        """Replace the mapping; it applies to Tasks that are posted later."""
        table = await orchestrator.deployments.set_mapping(
            body.entries, by=body.by.strip(), why=body.why, version=body.version
        )
        return json_response(mapping_view(table))


def _add_processes(app: FastAPI, at: Components) -> None:
    orchestrator, settings = at.orchestrator, at.settings
    store, registry = orchestrator.store, orchestrator.state.registry

    @app.post("/processes", status_code=201, tags=["processes"], responses={201: PROCESS[200], **PROCESS})
    @max_body(MAX_PARAMETERS_BYTES)
    async def start(body: ProcessStart) -> JSONResponse:
        """Start a process: 201, or 200 if the same key has started it before."""
        process_id, created = await orchestrator.processes.start(
            body.definition, body.parameters, version=body.version, key=body.key
        )
        view = await _shown(at, process_id)
        return JSONResponse(view, 201 if created else 200, {"Location": f"/processes/{process_id}"})

    @app.get("/processes", tags=["processes"], responses={200: {"model": list[ProcessSummary]}})
    async def processes(
        *,
        status: TaskStatus | None = None,
        definition: str | None = None,
        version: Annotated[int | None, Query(ge=1, le=MAX_VERSION)] = None,
        search: Annotated[
            str | None, Query(max_length=200, description="a part of the business key or of the id")
        ] = None,
        involves: Annotated[
            str | None,
            Query(max_length=300, description="the URN of a person or resource that a Task involves"),
        ] = None,
        before: Annotated[
            str | None, Query(description="the id of a process: return those started before it")
        ] = None,
        limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    ) -> Response:
        """Return processes, the latest first; `before` with the id of the last one returns the next page."""
        wanted = status.value if status is not None else None
        mark = at.plain_id(before) if before is not None else None
        records = await orchestrator.on_disk(
            lambda: store.page(
                status=wanted,
                definition=definition,
                version=version,
                search=search or None,
                involves=involves,
                before=mark,
                limit=limit,
            )
        )
        return json_response([process_summary(settings, registry, record) for record in records])

    @app.get("/statistics", tags=["processes"], responses={200: {"model": PeriodStatistics}})
    async def statistics(
        since: Annotated[
            AwareDatetime, Query(description="count processes that ended at this time or later")
        ],
    ) -> Response:
        """Return the number of running and ended processes since a time, and their median duration."""
        counts = await orchestrator.on_disk(store.counts_since, since.astimezone(UTC))
        return json_response(period_view(counts))

    @app.get("/processes/{process_id}", tags=["processes"], responses=PROCESS)
    async def process(process_id: str) -> Response:
        """Return a process with its variables, its Tasks, its waiting elements and its next activities."""
        return json_response(await _shown(at, process_id))

    @app.post("/processes/{process_id}/cancel", tags=["processes"], responses=PROCESS)
    async def cancel(process_id: str, body: CancelRequest | None = None) -> Response:
        """Cancel a process and its Tasks."""
        await orchestrator.processes.cancel(
            at.plain_id(process_id), body.by.strip() if body and body.by else None
        )
        return json_response(await _shown(at, process_id))

    @app.post("/processes/{process_id}/tasks/{task_id}/retry", tags=["processes"], responses=PROCESS)
    async def retry(process_id: str, task_id: str, body: RetryRequest) -> Response:
        """Post the failed Task that has ended a process again, as a new Task; the process continues."""
        await orchestrator.processes.retry(
            at.plain_id(process_id), settings.entity_id("Task", task_id), body.by.strip()
        )
        return json_response(await _shown(at, process_id))


def _add_interventions(app: FastAPI, at: Components) -> None:
    """Add what people do with running processes: pause, resume, and mend what cannot continue."""
    orchestrator = at.orchestrator

    async def mend(process_id: str, kind: ActKind, token: str | None, body: MendRequest) -> Response:
        check_variables(body.variables)
        await orchestrator.processes.mend(
            at.plain_id(process_id),
            kind,
            token,
            by=body.by.strip(),
            why=body.why,
            to=body.to if isinstance(body, MoveRequest) else None,
            values=body.variables,
        )
        return json_response(await _shown(at, process_id))

    @app.post("/processes/{process_id}/pause", tags=["processes"], responses=PROCESS)
    async def pause(process_id: str, body: PauseRequest) -> Response:
        """Pause a process: its Tasks are requested to pause, no other is posted, timers wait."""
        await orchestrator.processes.pause(
            at.plain_id(process_id), ActKind.PAUSE, by=body.by.strip(), why=body.why
        )
        return json_response(await _shown(at, process_id))

    @app.post("/processes/{process_id}/resume", tags=["processes"], responses=PROCESS)
    async def resume(process_id: str, body: PauseRequest) -> Response:
        """Continue a paused process, with the timers that were due meanwhile."""
        await orchestrator.processes.pause(
            at.plain_id(process_id), ActKind.RESUME, by=body.by.strip(), why=body.why
        )
        return json_response(await _shown(at, process_id))

    @app.post("/pause", tags=["processes"], responses={200: {"model": PausedProcesses}})
    async def pause_all(body: PauseRequest, definition: str | None = None) -> Response:
        """Pause all running processes, or those of a definition. Processes can still be started."""
        paused = await orchestrator.processes.pause_all(
            ActKind.PAUSE, by=body.by.strip(), why=body.why, definition=definition
        )
        return json_response({"processes": paused})

    @app.post("/resume", tags=["processes"], responses={200: {"model": PausedProcesses}})
    async def resume_all(body: PauseRequest, definition: str | None = None) -> Response:
        """Continue all paused processes, or those of a definition."""
        resumed = await orchestrator.processes.pause_all(
            ActKind.RESUME, by=body.by.strip(), why=body.why, definition=definition
        )
        return json_response({"processes": resumed})

    @app.post("/processes/{process_id}/variables", tags=["incidents"], responses=PROCESS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def set_variables(process_id: str, body: MendRequest) -> Response:
        """Set variables of a running process."""
        return await mend(process_id, ActKind.SET_VARIABLES, None, body)

    @app.post("/processes/{process_id}/tokens/{token}/retry", tags=["incidents"], responses=PROCESS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def retry_token(process_id: str, token: str, body: MendRequest) -> Response:
        """Let a token with an incident try again: a failed Task is posted again, as a new Task."""
        return await mend(process_id, ActKind.RETRY, token, body)

    @app.post("/processes/{process_id}/tokens/{token}/skip", tags=["incidents"], responses=PROCESS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def skip_token(process_id: str, token: str, body: MendRequest) -> Response:
        """Let a token leave its element, as if that had been done with the variables as results."""
        return await mend(process_id, ActKind.SKIP, token, body)

    @app.post("/processes/{process_id}/tokens/{token}/move", tags=["incidents"], responses=PROCESS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def move_token(process_id: str, token: str, body: MoveRequest) -> Response:
        """Move a token to another element of its scope; its present Task is cancelled."""
        return await mend(process_id, ActKind.MOVE, token, body)

    @app.post("/processes/{process_id}/tokens/{token}/cancel", tags=["incidents"], responses=PROCESS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def cancel_token(process_id: str, token: str, body: MendRequest) -> Response:
        """End a token where it is; the process ends if it was the last one."""
        return await mend(process_id, ActKind.CANCEL_BRANCH, token, body)


async def _shown(at: Components, process_id: str) -> dict[str, Any]:
    """Return a process with all details; raise `Problem` 404 if there is none."""
    store, registry = at.orchestrator.store, at.orchestrator.state.registry
    seen = await at.orchestrator.on_disk(store.everything, at.plain_id(process_id))
    if seen is None:
        raise Problem(
            404,
            "No such process",
            message("process.unknown", 'there is no process "{process_id}"', process_id=process_id),
        )
    await registry.prepare(registry.record(seen[0].definition, seen[0].version))
    return process_view(at.settings, registry, *seen)


async def _body(request: Request) -> bytes:
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > MAX_BYTES:
            raise BadBpmn(
                [
                    Fault(
                        None,
                        None,
                        message(
                            "bpmn.upload_too_large",
                            "a BPMN file has at most {max_bytes} bytes",
                            max_bytes=MAX_BYTES,
                        ),
                    )
                ]
            )
    return bytes(body)
