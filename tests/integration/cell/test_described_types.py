"""What the OpenAPI document of a service says of methods and of types of values holds for every route.

The services are those that `handover up` can start; a new one is included without a change here.
"""

import copy
import re
from collections.abc import AsyncIterator, Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute

from handover.extensions import application_of
from tests.integration.cell.test_rights_of_routes import SERVICES
from tests.kit.described_requests import DescribedRequests
from tests.kit.ports import next_free_port

METHODS = ("OPTIONS", "GET", "POST", "PUT", "PATCH", "DELETE")
NUMBERS = ("0", "0.5", "1e3", "-1")
OF_ANOTHER_TYPE: Mapping[type, tuple[Any, ...]] = {
    bool: (0, 1, "true"),
    int: (False, "1"),
    float: (True, "1"),
}
"""Values that pydantic would convert to the type."""
TYPE_FAULTS = {"bool_type", "int_type", "float_type"}


@pytest.fixture(params=SERVICES, ids=lambda service: service.name)
def app(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FastAPI:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HANDOVER_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("HANDOVER_GLOVE_PORT", str(next_free_port()))
    made = application_of(request.param)
    assert made is not None
    return made


@pytest.fixture
async def http(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        yield client


@pytest.mark.nightly
async def test_a_method_that_is_not_described_is_answered_with_those_that_are(
    app: FastAPI, http: httpx.AsyncClient
) -> None:
    for template, operations in app.openapi()["paths"].items():
        described = {method.upper() for method in operations}
        path = re.sub(r"\{[^}]*\}", "one", template)
        for method in set(METHODS) - described:
            if any(is_same_path(path, method, other, ones) for other, ones in app.openapi()["paths"].items()):
                continue
            answer = await http.request(method, path)
            if answer.status_code == 503 and answer.json()["title"] == "Standby":
                continue  # a service that does not lead refuses every change
            assert answer.status_code == 405, (method, path, answer.text)
            assert set(answer.headers["allow"].split(", ")) == described, (method, path)


def is_same_path(path: str, method: str, template: str, operations: Mapping[str, Any]) -> bool:
    """Return whether a described operation of another template, `/rules/{rule}`, has the path and method."""
    pattern = re.sub(r"\\\{[^}]*\\\}", "[^/]+", re.escape(template))
    return method.lower() in operations and re.fullmatch(pattern, path) is not None


@pytest.mark.nightly
async def test_a_number_is_refused_for_a_described_time(app: FastAPI, http: httpx.AsyncClient) -> None:
    for template, operations in app.openapi()["paths"].items():
        for method, operation in operations.items():
            for parameter in operation.get("parameters", ()):
                if "'date-time'" in str(parameter["schema"]):
                    for number in NUMBERS:
                        path = re.sub(r"\{[^}]*\}", "one", template)
                        answer = await http.request(method, path, params={parameter["name"]: number})
                        assert answer.status_code == 422, (method, path, number, answer.text)
                        assert "ISO 8601" in answer.json()["detail"]


@pytest.mark.nightly
def test_a_value_of_another_json_type_is_refused_in_every_body(app: FastAPI) -> None:
    described = DescribedRequests(app.openapi())
    bodies = {(one.method, one.template): one.body for one in described.valid() if one.body is not ...}
    for route in app.routes:
        if isinstance(route, APIRoute) and route.body_field is not None:
            for method in route.methods:
                for changed in of_other_types(bodies.get((method, route.path_format))):
                    _, faults = route.body_field.validate(changed, loc=("body",))
                    kinds = {fault["type"] for fault in faults}
                    assert kinds & TYPE_FAULTS, (method, route.path, changed, faults)


def of_other_types(body: Any) -> Iterator[Any]:
    """Yield copies of a body, each with one boolean or number in it as a value of another type."""
    for path, value in scalars(body):
        for other in OF_ANOTHER_TYPE.get(type(value), ()):
            changed = copy.deepcopy(body)
            parent = changed
            for step in path[:-1]:
                parent = parent[step]
            parent[path[-1]] = other
            yield changed


def scalars(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    members = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    )
    if members is None:
        if path:
            yield path, value
        return
    for step, member in members:
        yield from scalars(member, (*path, step))
