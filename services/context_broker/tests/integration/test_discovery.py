"""Discovery of types and attributes (clauses 5.7.5 to 5.7.10)."""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

DEFAULT = "https://uri.etsi.org/ngsi-ld/default-context/"
ERRORS = "https://uri.etsi.org/ngsi-ld/errors/"
TENANT = {"NGSILD-Tenant": "discovery"}


@pytest.fixture(scope="module")
def plant(shared_broker: Any) -> Iterator[httpx.Client]:
    """A tenant with two machines and a hall."""
    with httpx.Client(base_url=shared_broker.api, headers=TENANT, timeout=120, trust_env=False) as http:
        entities = [
            {"id": "urn:x:m1", "type": "Machine", "speed": 1, "isIn": {"object": "urn:x:h1"}},
            {"id": "urn:x:m2", "type": ["Machine", "Robot"], "speed": [
                {"type": "Property", "value": 1}, {"type": "Property", "value": 2, "datasetId": "urn:d:1"}
            ]},
            {"id": "urn:x:h1", "type": "Hall", "location": {
                "type": "GeoProperty", "value": {"type": "Point", "coordinates": [1, 2]}
            }},
            {"id": "urn:x:gone", "type": "Ghost", "aura": 1},
        ]  # fmt: skip
        assert http.post("/entityOperations/create", json=entities).status_code == 201
        assert http.delete("/entities/urn:x:gone").status_code == 204
        yield http


def test_types_are_listed_by_the_names_of_the_reader(plant: httpx.Client) -> None:
    found = plant.get("/types").json()
    assert found["type"] == "EntityTypeList"
    assert found["id"].startswith("urn:ngsi-ld:EntityTypeList:")
    assert found["typeList"] == ["Hall", "Machine", "Robot"]
    counted = plant.get("/types?count=true")
    assert counted.headers["ngsild-results-count"] == "3"
    linked = plant.get("/types", headers={"Accept": "application/ld+json"}).json()
    assert "@context" in linked


def test_types_are_returned_with_their_attributes(plant: httpx.Client) -> None:
    details = {one["typeName"]: one for one in plant.get("/types?details=true").json()}
    assert details["Machine"] == {
        "id": f"{DEFAULT}Machine",
        "type": "EntityType",
        "typeName": "Machine",
        "attributeNames": ["speed", "isIn"],
    }
    assert details["Robot"]["attributeNames"] == ["speed"]
    one = plant.get("/types/Machine").json()
    assert (one["type"], one["entityCount"]) == ("EntityTypeInfo", 2)
    assert one["attributeDetails"] == [
        {
            "id": f"{DEFAULT}speed",
            "type": "Attribute",
            "attributeName": "speed",
            "attributeTypes": ["Property"],
        },
        {
            "id": f"{DEFAULT}isIn",
            "type": "Attribute",
            "attributeName": "isIn",
            "attributeTypes": ["Relationship"],
        },
    ]


def test_attributes_are_listed_with_their_types(plant: httpx.Client) -> None:
    found = plant.get("/attributes").json()
    assert found["type"] == "AttributeList"
    assert sorted(found["attributeList"]) == ["isIn", "location", "speed"]
    details = {one["attributeName"]: one for one in plant.get("/attributes?details=true").json()}
    assert details["speed"] == {
        "id": f"{DEFAULT}speed",
        "type": "Attribute",
        "attributeName": "speed",
        "typeNames": ["Machine", "Robot"],
    }
    one = plant.get("/attributes/speed").json()
    assert one == details["speed"] | {"attributeCount": 3, "attributeTypes": ["Property"]}
    assert plant.get(f"/attributes/{DEFAULT.replace('/', '%2F')}speed").json() == one


@pytest.mark.parametrize(
    "path",
    ["types/Ghost", "types/id", "attributes/aura", *(f"attributes/{name}" for name in (
        "id", "type", "scope", "createdAt", "modifiedAt", "deletedAt"
    ))],
)  # fmt: skip
def test_a_missing_type_or_attribute_is_not_found(plant: httpx.Client, path: str) -> None:
    answer = plant.get(f"/{path}")
    assert (answer.status_code, answer.json()["type"]) == (404, f"{ERRORS}ResourceNotFound")


@pytest.mark.parametrize(
    "path",
    ["types?limit=5", "types/Hall?details=true", "attributes?limit=5", "attributes/speed?details=true"],
)
def test_parameters_that_discovery_does_not_have_are_refused(plant: httpx.Client, path: str) -> None:
    answer = plant.get(f"/{path}")
    assert (answer.status_code, answer.json()["type"]) == (400, f"{ERRORS}InvalidRequest")


def test_registered_types_and_attributes_are_returned_too(plant: httpx.Client) -> None:
    registration = {
        "id": "urn:x:registration:discovery",
        "type": "ContextSourceRegistration",
        "information": [
            {"entities": [{"type": "Crane"}], "propertyNames": ["load"]},
            {"entities": [{"type": "Hall"}], "relationshipNames": ["owner"]},
        ],
        "endpoint": "http://192.0.2.1:1026",
        "operations": ["retrieveEntity"],
    }
    assert plant.post("/csourceRegistrations", json=registration).status_code == 201
    assert "Crane" in plant.get("/types").json()["typeList"]
    assert "Crane" not in plant.get("/types?local=true").json()["typeList"]
    crane = plant.get("/types/Crane").json()
    assert (crane["entityCount"], crane["attributeDetails"][0]["attributeName"]) == (0, "load")
    assert plant.get("/types/Crane?local=true").status_code == 404
    details = {one["typeName"]: one for one in plant.get("/types?details=true").json()}
    assert details["Hall"]["attributeNames"] == ["location", "owner"]
    assert {"load", "owner"} <= set(plant.get("/attributes").json()["attributeList"])
    assert plant.get("/attributes/owner").json()["typeNames"] == ["Hall"]
    assert plant.delete("/csourceRegistrations/urn:x:registration:discovery").status_code == 204
    assert "Crane" not in plant.get("/types").json()["typeList"]


def test_types_are_those_of_the_tenant(plant: httpx.Client, http: httpx.Client) -> None:
    http.post("/entities", json={"id": "urn:x:1", "type": "Elsewhere"})
    assert "Elsewhere" in http.get("/types").json()["typeList"]
    assert "Elsewhere" not in plant.get("/types").json()["typeList"]
    assert "Machine" not in http.get("/types").json()["typeList"]
    assert plant.get("/types/Elsewhere").status_code == 404
