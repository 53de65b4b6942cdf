"""The mapping: its entries and files, and who gets an activity."""

from typing import Any

import pytest
from pydantic import ValidationError

from handover.errors import UsageError
from handover_bpmn.languages import native
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import Activity, Value
from handover_processes.allocation.agents import Agent, Agents, Skill
from handover_processes.allocation.assignment import AssignmentRules
from handover_processes.allocation.hints import follow_up_of
from handover_processes.allocation.mapping import (
    MappingEntry,
    MappingRequest,
    MappingTable,
    read_mapping_file,
)
from handover_processes.settings import OrchestratorSettings

GRIP = {"kind": "class", "name": "com.example.Grip", "resource": "Device:ur10-1"}


def activity(*, lane: str | None = None, involves: tuple[Value, ...] = (), **hints: str) -> Activity:
    return Activity(
        id="grip",
        name="Grip",
        description=None,
        lane=lane,
        definition="grip",
        deadline=None,
        involves=involves,
        happens_at=(),
        parameters={"operation": Value("com.example.Grip"), "part": Value("bolt")},
        outputs={},
        variable="grip",
        hints=hints,
    )


def rules(*entries: dict[str, Any], by: str | None = "Anna") -> AssignmentRules:
    made = AssignmentRules(OrchestratorSettings(_env_file=None))
    made.mapping = MappingTable(3, tuple(MappingEntry.model_validate(entry) for entry in entries), by)
    return made


def test_an_activity_without_an_entry_goes_to_people() -> None:
    hints = {"candidateGroups": "welders, packers", "candidateUsers": "ada", "assignee": "bob"}
    assignment = rules(GRIP).assign(activity(lane="Assembly", **hints), {})
    assert assignment.activity.involves == ()
    assert assignment.candidates == {
        "groups": ["welders", "packers"],
        "users": ["ada"],
        "assignee": "bob",
        "lane": "Assembly",
    }


def test_a_confirmed_entry_gives_work_to_a_robot_with_definition_and_parameters() -> None:
    entry = {**GRIP, "definition": "pick", "parameters": {"operation": "pick", "force": 20}}
    assignment = rules(entry).assign(activity(**{"class": "com.example.Grip"}), {})
    assert [value.literal for value in assignment.activity.involves] == ["Device:ur10-1"]
    assert assignment.activity.definition == "pick"
    assert {name: value.literal for name, value in assignment.activity.parameters.items()} == {
        "operation": "pick",
        "force": 20,
        "part": "bolt",
    }
    assert assignment.candidates is None
    assert assignment.reason.code == "allocation.by_entry"


def test_an_entry_that_nobody_confirmed_gives_no_work_to_a_robot() -> None:
    assignment = rules(GRIP, by=None).assign(activity(**{"class": "com.example.Grip"}), {})
    assert assignment.activity.involves == ()
    assert assignment.warning is not None
    assert assignment.warning.code == "allocation.unconfirmed"


def test_an_entry_that_nobody_confirmed_gives_work_to_a_person() -> None:
    entry = {"kind": "lane", "name": "Quality", "resource": "Person:ada"}
    assignment = rules(entry, by=None).assign(activity(lane="Quality"), {})
    assert [value.literal for value in assignment.activity.involves] == ["Person:ada"]


def test_the_most_specific_name_decides() -> None:
    entries = (
        {"kind": "lane", "name": "Robot", "resource": "Device:ur10-1"},
        {"kind": "topic", "name": "grip", "resource": "Device:ur10-2"},
        {"kind": "definition", "name": "grip", "resource": "Device:ur10-3"},
    )
    given = activity(lane="Robot", topic="grip")
    for left, expected in ((3, "Device:ur10-3"), (2, "Device:ur10-2"), (1, "Device:ur10-1")):
        assignment = rules(*entries[:left]).assign(given, {})
        assert assignment.performer == expected


def test_a_resource_of_the_file_comes_before_the_mapping() -> None:
    named = (Value(expression=native.read("robot")),)
    given = activity(involves=named, topic="grip")
    entry = {"kind": "topic", "name": "grip", "resource": "Device:ur10-2"}
    assert rules(entry).assign(given, {"robot": "Device:ur10-1"}).activity is given


def test_a_role_that_nobody_has_is_a_warning() -> None:
    entry = {"kind": "candidateGroup", "name": "welders", "role": "welder"}
    assignment = rules(entry).assign(activity(candidateGroups="welders"), {})
    assert assignment.performer == "role:welder"
    assert assignment.warning == "nobody has role:welder"


@pytest.mark.parametrize(
    ("hint", "text", "names"),
    [
        ("candidateGroups", "${team}", ["welders"]),
        ("candidateGroups", "=team", ["welders"]),
        ("candidateGroups", '=["welders", "packers"]', ["welders", "packers"]),
    ],
)
def test_hints_may_be_expressions(hint: str, text: str, names: list[str]) -> None:
    assignment = rules().assign(activity(**{hint: text}), {"team": "welders"})
    assert assignment.candidates == {"groups": names}


@pytest.mark.parametrize(
    "hint", ["candidateGroups", "candidateUsers", "assignee", "priority", "dueDate", "followUpDate"]
)
@pytest.mark.parametrize("text", ["${absent}", "${absent.name()}", "${1 +}", "=1 +"])
def test_a_hint_that_cannot_be_evaluated_is_an_error_that_names_it(hint: str, text: str) -> None:
    given = activity(**{hint: text})
    with pytest.raises(ExpressionError, match=hint):
        follow_up_of(rules().request(given, {}).activity, {})
    assert rules().assign(given, None).performer is None


def test_an_entry_for_the_text_of_an_expression_maps_what_cannot_be_evaluated() -> None:
    given = activity(lane="Robot", assignee="${robots.next()}")
    by_text = {"kind": "assignee", "name": "${robots.next()}", "resource": "Device:ur10-1"}
    by_lane = {"kind": "lane", "name": "Robot", "resource": "Device:ur10-2"}
    assert rules(by_text, by_lane).assign(given, {}).performer == "Device:ur10-1"
    with pytest.raises(ExpressionError, match="assignee"):
        rules(by_lane).assign(given, {})


@pytest.mark.parametrize("named", [{"role": "welder"}, {"skills": ["grip"]}])
def test_when_all_that_the_assignee_is_mapped_to_have_declined_the_groups_beside_get_it(
    named: dict[str, Any],
) -> None:
    deciding = rules({"kind": "assignee", "name": "bob", **named})
    suitable = [
        Agent(f"urn:ngsi-ld:Device:demo:arm-{number}", roles=frozenset({"welder"}), skills={"grip": Skill(1)})
        for number in (1, 2)
    ]
    other = Agent("urn:ngsi-ld:Device:demo:other")
    deciding.agents = Agents({each.id: each for each in (*suitable, other)})
    given = activity(assignee="bob", candidateGroups="packers")
    first, both = {suitable[0].id}, {each.id for each in suitable}
    for declined in (set(), first):
        assert deciding.request(given, {}, frozenset(declined)).request is not None
    assignment = deciding.request(given, {}, frozenset(both))
    assert (assignment.request, assignment.candidates) == (None, {"groups": ["packers"]})
    assert deciding.request(activity(assignee="bob"), {}, frozenset(both)).request is not None


def test_a_delegate_expression_is_mapped_by_its_name() -> None:
    entry = {"kind": "class", "name": "gripDelegate", "resource": "Device:ur10-1"}
    assignment = rules(entry).assign(activity(delegateExpression="${gripDelegate}"), {})
    assert assignment.performer == "Device:ur10-1"


@pytest.mark.parametrize(
    ("entry", "fault"),
    [
        ({"kind": "lane", "name": "Robot"}, "has one of resource, role and skills"),
        ({"kind": "lane", "name": "R", "role": "a", "skills": ["b"]}, "has one of resource, role and skills"),
        ({"kind": "lane", "name": "Robot", "resource": "ur10-1"}, "names no entity"),
        ({"kind": "pool", "name": "Robot", "role": "a"}, "kind"),
        ({"kind": "lane", "name": " ", "role": "a"}, "name"),
    ],
)
def test_a_wrong_entry_is_refused(entry: dict[str, Any], fault: str) -> None:
    with pytest.raises(ValidationError, match=fault):
        MappingEntry.model_validate(entry)


def test_a_name_with_two_entries_is_refused() -> None:
    with pytest.raises(ValidationError, match="has two entries"):
        MappingRequest.model_validate({"by": "Anna", "entries": [GRIP, GRIP]})


def test_a_file_names_its_faults() -> None:
    read = read_mapping_file("by: Anna\nentries:\n- {kind: lane, name: Robot, resource: 'Device:ur10-1'}\n")
    assert read.by == "Anna"
    assert read.entries[0].resource == "Device:ur10-1"
    with pytest.raises(UsageError, match="names no entity"):
        read_mapping_file("entries: [{kind: lane, name: Robot, resource: x}]")
    with pytest.raises(UsageError, match="no YAML"):
        read_mapping_file("entries: [")
