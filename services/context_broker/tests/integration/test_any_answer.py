"""Any response of a context source: the broker sends a valid response to its client."""

from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.kit.context_sources import ScriptedSource, register

ID = "urn:ngsi-ld:AnyAnswer:1"
OPERATIONS = [
    "redirectionOps", "retrieveTemporal", "queryTemporal", "createBatch", "upsertBatch", "deleteBatch",
    "mergeBatch", "updateBatch", "createSubscription",
]  # fmt: skip
ASKED = {
    "GET": (
        f"entities/{ID}", "entities", "types", "types/AnyAnswer", "attributes", "attributes/a",
        f"temporal/entities/{ID}", "temporal/entities",
    ),
    "POST": ("entityOperations/create", "entityOperations/delete", f"entities/{ID}/attrs", "entities"),
    "PATCH": (f"entities/{ID}", f"entities/{ID}/attrs/a"),
    "DELETE": (f"entities/{ID}",),
}  # fmt: skip

_leaves = (
    st.none() | st.booleans() | st.integers(-3, 3) | st.sampled_from(["", "a", ID, "AnyAnswer", "Property"])
)
_names = st.sampled_from(
    ["id", "type", "a", "@context", "value", "values", "observedAt", "typeList", "attributeList", "success",
     "attributeDetails", "attributeTypes", "typeNames", "attributeName", "typeName", "entityCount", "errors",
     "entityId", "error", "status", "title", "createdAt", "scope", "expiresAt", "datasetId", "modifiedAt"]
)  # fmt: skip
_anything: st.SearchStrategy[Any] = st.recursive(
    _leaves,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_names, inner, max_size=5),
    max_leaves=12,
)
_entities = st.fixed_dictionaries(
    {"id": st.just(ID) | _leaves, "type": st.just("AnyAnswer") | _leaves},
    optional={"a": _anything, "scope": _anything},
)
_answers = _anything | _entities | st.lists(_entities | _anything, max_size=3)


@pytest.mark.nightly
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(said=_answers, status=st.sampled_from([200, 200, 200, 201, 204, 207, 302, 404, 409, 500, 508]))
def test_any_answer_is_borne(anyone: httpx.Client, answering: ScriptedSource, said: Any, status: int) -> None:
    for method, paths in ASKED.items():
        for path in paths:
            answering.answers[method, f"/ngsi-ld/v1/{path}"] = status, said
            body: Any = {"id": ID, "type": "AnyAnswer", "a": 1} if path == "entities" else {"a": 1}
            if path.startswith("entityOperations"):
                body = [ID] if path.endswith("delete") else [{"id": ID, "type": "AnyAnswer", "a": 1}]
            if path.endswith("/a"):
                body = {"type": "Property", "value": 1} if method == "PATCH" else None
            query = {"options": "sysAttrs"} if path.startswith("entities") and method == "GET" else {}
            if path.endswith("entities") and method == "GET":
                query |= {"type": "AnyAnswer"}
            if path == "temporal/entities":
                query |= {"timerel": "after", "timeAt": "2025-01-01T00:00:00Z"}
            answer = anyone.request(method, f"/{path}", params=query, json=None if method == "GET" else body)
            assert answer.status_code in {200, 201, 204, 207, 404, 409, 502, 504, 508}, (
                method,
                path,
                answer.text,
            )
            if answer.content:
                answer.json()


@pytest.fixture
def answering() -> Any:
    made = ScriptedSource()
    yield made
    made.stop()


@pytest.fixture
def anyone(shared_broker: Any, answering: ScriptedSource) -> Any:
    with shared_broker.client() as client:
        path = register(client, answering.url, {"type": "AnyAnswer"}, mode="redirect", operations=OPERATIONS)
        yield client
        client.delete(path)
