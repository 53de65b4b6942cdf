"""The orchestrator's HTTP interface in this process; every response is compared with its declared type."""

import json
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import httpx
from fastapi import FastAPI
from fastapi.routing import APIRoute
from pydantic import TypeAdapter

from handover.broker import BrokerClient
from handover.subscriptions.notifications import KEY_HEADER
from handover_datamodels.times import iso
from handover_processes.app import make_app
from handover_processes.running.orchestrator import utc_now
from handover_processes.settings import OrchestratorSettings
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, drawing
from tests.kit.databases import default_url

NOBODY = "http://127.0.0.1:9"
"""The discard port: no broker answers there."""
XML = {"Content-Type": "application/xml"}
KEYED = {KEY_HEADER: "what-the-broker-sends"}


def settings_in(folder: Path, **more: Any) -> OrchestratorSettings:
    given = {"broker_url": NOBODY, "notification_key": KEYED[KEY_HEADER], **more}
    return OrchestratorSettings(_env_file=None, data_dir=folder, database_url=default_url(folder), **given)


@asynccontextmanager
async def service(settings: OrchestratorSettings) -> AsyncIterator[httpx.AsyncClient]:
    """A client of a service; every response to it is compared with its type."""
    app = make_app(settings)
    transport = httpx.ASGITransport(app)
    hooks = {"response": [partial(check_type, types_of(app))]}
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://localhost", event_hooks=hooks) as client,
    ):
        yield client


def types_of(app: FastAPI) -> dict[tuple[str, str, int], TypeAdapter[Any]]:
    """The declared types of the JSON responses, by method, pattern of the path and status."""
    return {
        (method, route.path_regex.pattern, int(status)): TypeAdapter(response["model"])
        for route in app.routes
        if isinstance(route, APIRoute)
        for method in route.methods
        for status, response in route.responses.items()
        if "model" in response
    }


async def check_type(types: dict[tuple[str, str, int], TypeAdapter[Any]], response: httpx.Response) -> None:
    """Fail if a JSON response has no declared type, a member that its type lacks, or lacks one itself."""
    asked = response.request
    is_json = response.headers.get("content-type") == "application/json"
    if not response.is_success or not is_json or asked.url.path in {"/healthz", "/readyz"}:
        return
    (declared,) = [
        type_
        for (method, path, status), type_ in types.items()
        if (method, status) == (asked.method, response.status_code) and re.match(path, asked.url.path)
    ]
    body = await response.aread()
    assert declared.validate_json(body, strict=True) == json.loads(body), f"{asked.method} {asked.url.path}"


async def deployed(api: httpx.AsyncClient, body: str = ONE_STEP) -> None:
    assert (await api.post("/definitions", content=drawing(body), headers=XML)).status_code == 201


def a_task(task: str, status: str, **outputs: Any) -> dict[str, Any]:
    return {
        "id": task,
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:work"},
        "status": {"type": "Property", "value": status, "observedAt": iso(utc_now())},
        "outputParameters": {"type": "Property", "value": outputs},
    }


async def notify(api: httpx.AsyncClient, *entities: Any, **headers: str) -> httpx.Response:
    """Notify the orchestrator as the broker does."""
    body = {"type": "Notification", "data": entities}
    return await api.post("/notifications", json=body, headers=KEYED | headers)


async def moved(
    api: httpx.AsyncClient, broker: BrokerClient, task: str, status: str, **outputs: Any
) -> httpx.Response:
    """Move a Task in the broker, and notify the orchestrator of it."""
    entity = a_task(task, status, **outputs)
    await broker.upsert([entity])
    return await notify(api, entity)
