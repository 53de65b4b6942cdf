"""A document is described once: its fields say where their values come from."""

from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Annotated, Any, NotRequired

import pytest
from pydantic import TypeAdapter
from typing_extensions import TypedDict

from handover.messages import message
from handover_bpmn.notation.file import read_bpmn
from handover_processes.allocation.allocator import Allocator
from handover_processes.allocation.mapping import MappingEntry, MappingTable, NameKind
from handover_processes.documents.document import (
    Coded,
    From,
    Moment,
    OptionalMoment,
    coded,
    document,
    documents,
)
from handover_processes.documents.mapping import MappingUse, mapping_use
from handover_processes.settings import OrchestratorSettings
from services.task_orchestrator.tests.unit.drawing import drawing, end, path, start

AT = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)


@dataclass
class Part:
    serial_number: str
    parts: tuple["Part", ...] = ()
    at: datetime = AT
    ended_at: datetime | None = None
    reason: str | None = None
    names: tuple[str, ...] = ("a", "b")
    by_name: dict[str, "Part"] = field(default_factory=dict)
    inner: "Part | None" = None


class PartView(TypedDict):
    serialNumber: str
    at: Moment
    endedAt: OptionalMoment
    names: list[str]
    count: Annotated[int, From(lambda part: len(part.parts))]
    parts: list["PartView"]
    byName: dict[str, "PartView"]
    inner: "PartView | None"
    owner: str
    reason: Annotated[str | None, Coded()]
    reasonCode: NotRequired[str]
    reasonParameters: NotRequired[dict[str, Any]]


class SimpleView(TypedDict):
    serialNumber: str


def view(part: Part, **values: Any) -> dict[str, Any]:
    content: dict[str, Any] = dict(document(PartView, part, **{"owner": "Olga", "parts": [], **values}))
    return content


def test_fields_have_the_attributes_of_the_record_as_json_has_them() -> None:
    content = view(Part("p-1"))
    assert content["serialNumber"] == "p-1"
    assert content["at"] == "2026-05-04T08:00:00.000000Z"
    assert content["endedAt"] is None
    assert content["names"] == ["a", "b"]
    assert content["owner"] == "Olga"


def test_a_field_may_be_computed_from_the_record() -> None:
    assert view(Part("p-1", parts=(Part("p-2"),)))["count"] == 1


def test_records_within_a_record_are_documents() -> None:
    class Outer(TypedDict):
        parts: list[SimpleView]
        byName: dict[str, SimpleView]
        inner: SimpleView | None

    inside = Part("p-2")
    outer = Part("p-1", parts=(inside,), by_name={"x": inside}, inner=inside)
    simple = {"serialNumber": "p-2"}
    assert document(Outer, outer) == {"parts": [simple], "byName": {"x": simple}, "inner": simple}
    assert document(Outer, Part("p-1")) == {"parts": [], "byName": {}, "inner": None}
    assert documents(SimpleView, [inside]) == [simple]


def test_a_text_for_people_has_its_code_and_parameters() -> None:
    reason = message("part.lost", "{part} is lost", part="p-1")
    assert {"reason", "reasonCode", "reasonParameters"} <= view(Part("p-1", reason=reason)).keys()
    assert view(Part("p-1"))["reason"] is None
    assert "reasonCode" not in view(Part("p-1", reason="lost"))
    assert view(Part("p-1"), **coded("reason", "given"))["reason"] == "given"


def test_a_field_without_a_source_is_an_error() -> None:
    with pytest.raises(AttributeError, match="owner"):
        document(PartView, Part("p-1"))


def test_the_names_of_definitions_and_the_entries_of_the_mapping_are_shown() -> None:
    body = start() + '<bpmn:userTask id="work" name="Pick"/>' + end() + path("start", "work", "end")
    allocator = Allocator(OrchestratorSettings(_env_file=None))
    allocator.rules.mapping = MappingTable(
        1, (MappingEntry(kind=NameKind.DEFINITION, name="pick", role="picker"),)
    )
    use = mapping_use(allocator, read_bpmn(drawing(body)).definitions)
    TypeAdapter(MappingUse).validate_python(use)
    assert use["names"][0]["activities"] == [{"definition": "p", "element": "work", "name": "Pick"}]
    assert [entry["name"] for entry in use["missing"]] == ["pick"]
    assert "warningCode" in use["missing"][0]
