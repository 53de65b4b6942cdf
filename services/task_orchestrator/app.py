"""The doors: deploy a definition, start a process, look at it, cancel it; and the bell the broker rings."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC
from pathlib import Path
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request, Response
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field
from starlette.responses import JSONResponse

from datamodels.entities import TaskStatus
from handover.body_limit import max_body
from handover.broker import BrokerClient
from handover.errors import Problem
from handover.messages import message
from handover.service import XML_TYPES, accepts, create_app
from handover.storage import storage_check
from handover.telemetry import get_logger
from services.task_orchestrator.archive import Archiver
from services.task_orchestrator.definition import BadBpmn, Fault
from services.task_orchestrator.orchestrator import Orchestrator
from services.task_orchestrator.reconcile import Reconciler
from services.task_orchestrator.settings import OrchestratorSettings
from services.task_orchestrator.views import (
    activity_views,
    definition_view,
    period_view,
    process_summary,
    process_view,
    statistics_view,
)
from services.task_orchestrator.xml_names import MAX_BYTES

log = get_logger(__name__)

MAX_PARAMETERS_BYTES = 1024 * 1024
MAX_VERSION = 2**31 - 1
SHIPPED = Path(__file__).parent / "processes"


class ProcessStart(BaseModel):
    """What it takes to start a process."""

    model_config = ConfigDict(extra="forbid")

    definition: str = Field(description="the name of a deployed definition")
    version: int | None = Field(None, description="a version of it; the latest if absent")
    parameters: dict[str, Any] = Field(default_factory=dict, description="its parameters")
    key: str | None = Field(
        None, pattern=r"^[^\x00]{1,200}$", description="the same key never starts a second process"
    )


Name = Annotated[str, Field(pattern=r"^[^\x00]*[^\x00\s][^\x00]*$", max_length=200)]


class Cancelling(BaseModel):
    """Who cancels a process, if that is known."""

    model_config = ConfigDict(extra="forbid")

    by: Name | None = Field(None, description="who cancels it")


class Retrying(BaseModel):
    """Who has a failed Task done anew."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="who wants it")


class Orchestration:
    """What the routes share: the orchestrator and its reconciler, while the service is up."""

    def __init__(self, settings: OrchestratorSettings) -> None:
        self.settings = settings
        self.broker = BrokerClient(settings)
        self.orchestrator = Orchestrator(settings, self.broker)
        self.reconciler = Reconciler(self.orchestrator, self.broker)
        self.archiver = Archiver(self.orchestrator, self.broker)

    @asynccontextmanager
    async def at_work(self, _: FastAPI) -> AsyncIterator[None]:
        """Deploy what is at hand and work until the service ends."""
        async with self.broker, self.orchestrator:
            await self._deploy_folder(SHIPPED)
            if self.settings.process_dir is not None:
                await self._deploy_folder(self.settings.process_dir)
            async with self.reconciler, self.archiver:
                yield

    async def _deploy_folder(self, folder: Path) -> None:
        if not await asyncio.to_thread(folder.is_dir):
            log.warning("there is no such folder of BPMN files", folder=str(folder))
        for file in await asyncio.to_thread(lambda: sorted(folder.glob("*.bpmn"))):
            try:
                xml = await asyncio.to_thread(file.read_bytes)
                deployment = await self.orchestrator.deploy(xml, only_if_never_seen=True)
            except BadBpmn as bad:
                faults = [str(fault) for fault in bad.faults]
                log.warning("BPMN file cannot be deployed", file=str(file), faults=faults)
            except OSError as error:
                log.warning("BPMN file cannot be read", file=str(file), error=str(error))
            else:
                log.info("definition at hand", name=deployment.name, version=deployment.version)

    async def check_database(self) -> None:
        """Return if the database answers."""
        await self.orchestrator.on_disk(self.orchestrator.store.probe)


def make_app(settings: OrchestratorSettings) -> FastAPI:
    """Return the service; nothing is opened before its lifespan begins."""
    at = Orchestration(settings)
    app = create_app(
        "Task orchestrator",
        description="Runs BPMN processes: each activity becomes a Task for a person or a robot.",
        lifespan=at.at_work,
        checks={
            "database": at.check_database,
            "broker": at.broker.probe,
            "subscription": at.reconciler.probe,
            "storage": storage_check(settings.data_dir),
        },
    )
    _add_definitions(app, at.orchestrator)
    _add_processes(app, at)

    @app.post("/notifications", status_code=204, tags=["notifications"])
    async def notify(request: Request) -> Response:
        """Read the Tasks that have changed from the broker; answered when what that says is on disk."""
        await at.reconciler.take_notification(request)
        return Response(status_code=204)

    return app


def _add_definitions(app: FastAPI, orchestrator: Orchestrator) -> None:
    library = orchestrator.library

    @app.post("/definitions", status_code=201, tags=["definitions"])
    @accepts(*XML_TYPES)
    @max_body(2 * MAX_BYTES)
    async def deploy(request: Request, *, dry: bool = False) -> JSONResponse:
        """Deploy a BPMN file (the body is the XML): 201 for a new version, 200 if it is deployed already.

        With `dry` nothing is deployed: 200 if it could be, and the version it would be.
        """
        body = await _body(request)
        if dry:
            return JSONResponse(await orchestrator.try_out(body), 200)
        deployment = await orchestrator.deploy(body)
        view = definition_view(library, library.record(deployment.name, deployment.version))
        return JSONResponse(view, 201 if deployment.created else 200)

    @app.get("/definitions", tags=["definitions"])
    async def definitions() -> list[dict[str, Any]]:
        """Return the latest version of every definition."""
        latest = library.latest()
        for record in latest:
            await library.prepare(record)
        return [definition_view(library, record) for record in latest]

    @app.get("/definitions/{name}", tags=["definitions"])
    async def definition(name: str, version: int | None = None) -> dict[str, Any]:
        """Return a definition with its activities."""
        record = library.record(name, version)
        await library.prepare(record)
        activities = activity_views(library.plan(record).definition)
        return {**definition_view(library, record), "activities": activities}

    @app.get("/definitions/{name}/statistics", tags=["definitions"])
    async def statistics(name: str, version: int | None = None) -> dict[str, Any]:
        """Return what became of all processes of a version (the latest if none is named), by activity."""
        record = library.record(name, version)
        counts = await orchestrator.on_disk(orchestrator.store.counts, record.name, record.version)
        return statistics_view(record, counts)

    @app.get("/definitions/{name}/bpmn", tags=["definitions"])
    async def bpmn(name: str, version: int | None = None) -> Response:
        """Return the BPMN file as it was deployed."""
        return Response(library.record(name, version).xml, media_type="application/xml")


def _add_processes(app: FastAPI, at: Orchestration) -> None:
    orchestrator, settings = at.orchestrator, at.settings
    store, library = orchestrator.store, orchestrator.library

    @app.post("/processes", status_code=201, tags=["processes"])
    @max_body(MAX_PARAMETERS_BYTES)
    async def start(body: ProcessStart) -> JSONResponse:
        """Start a process: 201, or 200 if the same key has started it before."""
        process_id, created = await orchestrator.begin(
            body.definition, body.parameters, version=body.version, key=body.key
        )
        view = await _process(process_id)
        return JSONResponse(view, 201 if created else 200, {"Location": f"/processes/{process_id}"})

    @app.get("/processes", tags=["processes"])
    async def processes(
        *,
        status: TaskStatus | None = None,
        definition: str | None = None,
        version: Annotated[int | None, Query(ge=1, le=MAX_VERSION)] = None,
        search: Annotated[
            str | None, Query(max_length=200, description="a part of the business key or of the id")
        ] = None,
        involves: Annotated[
            str | None, Query(max_length=300, description="a person or a resource: those with a Task for it")
        ] = None,
        before: Annotated[str | None, Query(description="a process: those started before it")] = None,
        limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    ) -> list[dict[str, Any]]:
        """Return processes, the latest first; the last one's id as `before` gives the next page."""
        wanted = status.value if status is not None else None
        mark = _plain(before) if before is not None else None
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
        return [process_summary(settings, library, record) for record in records]

    @app.get("/statistics", tags=["processes"])
    async def statistics(
        since: Annotated[AwareDatetime, Query(description="those that ended at this moment or later")],
    ) -> dict[str, Any]:
        """Return how many processes run, how many ended since a moment and how, and their median duration."""
        return period_view(await orchestrator.on_disk(store.counts_since, since.astimezone(UTC)))

    @app.get("/processes/{process_id}", tags=["processes"])
    async def process(process_id: str) -> dict[str, Any]:
        """Return a process with its variables, its Tasks, where it waits and what may come next."""
        return await _process(process_id)

    @app.post("/processes/{process_id}/cancel", tags=["processes"])
    async def cancel(process_id: str, body: Cancelling | None = None) -> dict[str, Any]:
        """Cancel a process and the Tasks it has handed out."""
        await orchestrator.cancel(_plain(process_id), body.by.strip() if body and body.by else None)
        return await _process(process_id)

    @app.post("/processes/{process_id}/tasks/{task_id}/retry", tags=["processes"])
    async def retry(process_id: str, task_id: str, body: Retrying) -> dict[str, Any]:
        """Have the failed Task that has ended a process done anew, as a new Task; the process goes on."""
        await orchestrator.retry(_plain(process_id), settings.entity_id("Task", task_id), body.by.strip())
        return await _process(process_id)

    async def _process(process_id: str) -> dict[str, Any]:
        seen = await orchestrator.on_disk(store.everything, _plain(process_id))
        if seen is None:
            raise Problem(
                404,
                "No such process",
                message("process.unknown", 'there is no process "{process_id}"', process_id=process_id),
            )
        await library.prepare(library.record(seen[0].definition, seen[0].version))
        return process_view(settings, library, *seen)

    def _plain(process_id: str) -> str:
        return process_id.removeprefix(settings.entity_id("Process", ""))


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
