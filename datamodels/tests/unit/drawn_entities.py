"""Strategies of hypothesis for entities of every type of the data model."""

from typing import Any

from hypothesis import strategies as st

from handover_datamodels import (
    TYPES,
    CellState,
    DeviceState,
    MeasurementStatus,
    RequestedStatus,
    Severity,
    TaskStatus,
)

words = st.text(st.characters(codec="utf-8"), max_size=12)
names = st.sampled_from(["mass", "colour", "hand", "value2", "x_y", "temperature"])
uris = st.from_regex(r"urn:ngsi-ld:[A-Z][a-z]{1,6}:demo:[a-z0-9]{1,6}", fullmatch=True)
numbers = st.integers(-(10**9), 10**9) | st.floats(allow_nan=False, allow_infinity=False)
tricky = st.sampled_from(
    [
        {"value": 5},
        {"object": "urn:x:y"},
        {"type": "Property", "value": 1},
        [{"type": "Relationship", "object": "urn:x:y"}],
        {"type": "Point", "coordinates": [1, 2]},
        {"@type": "DateTime", "@value": "2026-01-01T00:00:00Z"},
        {"json": {}},
        {"languageMap": {"fi": "käsi"}, "observedAt": 3},
        {"dataset": {"a": 1}},
        "urn:ngsi-ld:Device:demo:x",
    ]
)
anything = st.recursive(
    st.booleans() | numbers | words | st.none() | tricky,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=6,
)
stated = anything.filter(lambda value: value is not None)  # null is no value in NGSI-LD
objects = st.dictionaries(words, anything, max_size=3)
moments = st.datetimes().map(lambda moment: moment.isoformat(timespec="milliseconds") + "Z")
points = st.tuples(numbers, numbers).map(lambda at: {"type": "Point", "coordinates": list(at)})
date_times = moments.map(lambda text: {"@type": "DateTime", "@value": text})

SAID = {
    "Property": stated,
    "Relationship": uris,
    "GeoProperty": points,
    "LanguageProperty": st.dictionaries(st.sampled_from(["en", "fi", "de"]), words, min_size=1),
    "JsonProperty": anything,
    "VocabProperty": words,
    "ListProperty": st.lists(anything, max_size=3),
    "ListRelationship": st.lists(st.fixed_dictionaries({"object": uris}), min_size=1, max_size=3),
}
MEMBER = {
    "LanguageProperty": "languageMap",
    "JsonProperty": "json",
    "VocabProperty": "vocab",
    "ListProperty": "valueList",
    "ListRelationship": "objectList",
    "Relationship": "object",
}


@st.composite
def attributes(draw: st.DrawFn, kind: str, said: st.SearchStrategy[Any], depth: int = 1) -> dict[str, Any]:
    """Draw a normalized attribute of `kind` that says one of `said`, with metadata and sub-attributes."""
    attribute: dict[str, Any] = {"type": kind, MEMBER.get(kind, "value"): draw(said)}
    attribute |= draw(
        st.fixed_dictionaries({}, optional={"observedAt": moments, "createdAt": moments, "datasetId": uris})
    )
    if kind == "Property" and draw(st.booleans()):
        attribute["unitCode"] = draw(st.sampled_from(["MTR", "CEL", "P1"]))
    if depth:
        for name in draw(st.lists(names, max_size=2)):
            attribute[name] = draw(others(depth - 1))
    return attribute


def others(depth: int = 1) -> st.SearchStrategy[Any]:
    """Return attributes that the vocabulary does not know, of every kind."""
    return st.sampled_from(list(SAID)).flatmap(lambda kind: attributes(kind, SAID[kind], depth))


def property_of(said: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return attributes("Property", said)


@st.composite
def measurements_of(draw: st.DrawFn, said: st.SearchStrategy[Any]) -> Any:
    """Draw one measurement, or a fused value and those of two sensors."""
    instances = [
        draw(attributes("Property", said, 0))
        | draw(
            st.fixed_dictionaries(
                {},
                optional={
                    "quality": attributes("Property", st.floats(0, 1), 0),
                    "status": attributes("Property", st.sampled_from([*map(str, MeasurementStatus)]), 0),
                    "method": attributes("Property", words, 0),
                    "observedBy": attributes("Relationship", uris, 0),
                },
            )
        )
        for _ in range(draw(st.sampled_from([1, 3])))
    ]
    if len(instances) == 1:
        return instances[0]
    instances[0].pop("datasetId", None)
    named = [
        one | {"datasetId": f"urn:ngsi-ld:Dataset:{number}"} for number, one in enumerate(instances[1:], 1)
    ]
    return [instances[0], *named]


links = st.lists(attributes("Relationship", uris), max_size=3)
one_of = {
    state: st.sampled_from([str(word) for word in state])
    for state in (TaskStatus, DeviceState, CellState, Severity)
}
requested = st.sampled_from([str(word) for word in RequestedStatus])
lists_of_words = st.lists(words, max_size=3)
relationship = attributes("Relationship", uris)
text = property_of(words)

REQUIRED: dict[str, dict[str, Any]] = {
    "ProcessDefinition": {"name": text, "version": text, "bpmn": text},
    "TaskDefinition": {"name": text},
    "ResourceSpecification": {"name": text, "resourceType": text},
    "Location": {"name": text},
    "Process": {"isDefinedBy": relationship, "status": property_of(one_of[TaskStatus])},
    "Task": {"isDefinedBy": relationship, "status": property_of(one_of[TaskStatus])},
    "Device": {"controlledProperty": property_of(lists_of_words)},
    "Material": {},
    "Asset": {},
    "Person": {},
    "Alert": {"category": text, "dateIssued": property_of(date_times), "alertSource": relationship},
    "SpeedLimit": {
        "refRobot": relationship,
        "fraction": property_of(st.floats(0, 1)),
        "reason": text,
        "validUntil": property_of(date_times),
    },
    "Cell": {
        "identity": text,
        "cellState": property_of(one_of[CellState]),
        "lastSeen": property_of(date_times),
    },
    "HumanState": {"refPerson": relationship},
    "PressureMat": {"refDevice": relationship},
    "PhysiologicalSession": {"refPerson": relationship, "startedAt": property_of(date_times)},
}
OPTIONAL: dict[str, dict[str, Any]] = {
    "ProcessDefinition": {"description": text},
    "TaskDefinition": {
        "gesture": text,
        "commandId": property_of(st.integers(0, 99)),
        "requiredSkills": property_of(lists_of_words),
        "workParametersSchema": property_of(objects),
        "isPartOf": relationship,
    },
    "ResourceSpecification": {"skills": property_of(lists_of_words), "parameters": property_of(objects)},
    "Location": {"location": attributes("GeoProperty", points), "isPartOf": relationship},
    "Process": {
        "workParameters": property_of(objects),
        "outputParameters": property_of(objects),
        "isComposedOf": property_of(links),
    },
    "Task": {
        "involves": property_of(links),
        "happensAt": property_of(links),
        "description": text,
        "workParameters": property_of(objects),
        "outputParameters": property_of(objects),
        "requestedStatus": property_of(requested),
        "deadline": property_of(date_times),
    },
    "Device": {
        "category": property_of(lists_of_words),
        "source": text | relationship,
        "serialNumber": text,
        "value": property_of(stated),
        "deviceState": property_of(one_of[DeviceState]),
        "batteryLevel": property_of(numbers),
        "relativePosition": property_of(st.lists(numbers, max_size=3)),
        "isSpecifiedBy": property_of(links),
        "commandId": property_of(st.integers(0, 99)),
        "performer": text,
    },
    "Material": {"description": text, "state": property_of(stated), "isSpecifiedBy": property_of(links)},
    "Asset": {"description": text, "state": property_of(stated), "isSpecifiedBy": property_of(links)},
    "Person": {"firstName": text, "lastName": text, "state": property_of(stated), "performer": text},
    "Alert": {
        "subCategory": text,
        "severity": property_of(one_of[Severity]),
        "description": text,
        "validFrom": property_of(date_times),
        "validTo": property_of(date_times),
        "location": attributes("GeoProperty", points),
        "source": text | relationship,
        "humanVerified": property_of(st.booleans()),
    },
    "SpeedLimit": {"refPerson": relationship, "maxSpeed": property_of(numbers)},
    "Cell": {"runningProcesses": property_of(st.integers(0, 99)), "incidents": property_of(st.just(0))},
    "HumanState": {
        "heartRate": measurements_of(numbers),
        "breathingRate": measurements_of(numbers),
        "hrvRmssd": measurements_of(numbers),
        "spo2": measurements_of(numbers),
        "activity": measurements_of(words),
        "wearState": measurements_of(words),
        "exertionLevel": measurements_of(words) | measurements_of(numbers),
        "stress": measurements_of(numbers),
    },
    "PressureMat": {
        "copX": measurements_of(numbers),
        "copY": measurements_of(numbers),
        "load": measurements_of(numbers),
        "activeCells": measurements_of(st.integers(0, 99)),
    },
    "PhysiologicalSession": {
        "endedAt": property_of(date_times),
        "recording": property_of(uris),
        "sha256": property_of(st.binary(min_size=32, max_size=32).map(bytes.hex)),
    },
}


@st.composite
def entities(draw: st.DrawFn, kind: str | None = None) -> dict[str, Any]:
    """Draw a normalized entity of any type of the vocabulary, or of `kind`, with foreign attributes."""
    name = kind or draw(st.sampled_from(sorted(TYPES)))
    entity: dict[str, Any] = {"id": draw(uris), "type": name}
    entity |= draw(st.fixed_dictionaries(REQUIRED[name], optional=OPTIONAL[name]))
    for other in draw(st.lists(names, max_size=2)):
        entity[other] = draw(others())
    if draw(st.booleans()):
        entity["many"] = [draw(others()), {**draw(others()), "datasetId": "urn:ngsi-ld:Dataset:2"}]
    return entity
