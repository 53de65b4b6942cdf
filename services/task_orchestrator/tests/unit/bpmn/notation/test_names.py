"""Names of elements in variables, definitions and URNs."""

import re

from hypothesis import given
from hypothesis import strategies as st

from handover_bpmn.languages.native_grammar import is_variable_name
from handover_bpmn.notation.names import (
    MAX_IN_URN,
    MAX_NODE_ID,
    definition_of,
    in_urn,
    variable_of,
)
from services.task_orchestrator.tests.unit.bpmn.notation.reading import between, faults, read, warnings
from services.task_orchestrator.tests.unit.drawing import end, path, start

_IDS = st.from_regex(r"\A[^\W\d][\w.\-]{0,199}\Z")


@given(_IDS)
def test_every_id_makes_a_variable(element: str) -> None:
    assert is_variable_name(variable_of(element))


@given(_IDS, st.text(max_size=30))
def test_every_id_makes_a_definition(element: str, drawn: str) -> None:
    assert re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,199}", definition_of(element, drawn))


@given(st.lists(_IDS, min_size=1, max_size=8))
def test_elements_within_called_processes_are_parts_of_a_urn(elements: list[str]) -> None:
    name = in_urn(".".join(elements))
    assert re.fullmatch(r"[A-Za-z0-9_.-]+", name)
    assert len(name) <= MAX_IN_URN


def test_short_ids_stay_as_they_are_in_a_urn() -> None:
    assert in_urn("call.pick-part_2") == "call.pick-part_2"
    assert in_urn("Prüfen") != in_urn("Prüfén")


def test_an_id_may_have_letters_of_every_script_and_be_long() -> None:
    long = "x" * MAX_NODE_ID
    body = (
        start()
        + f'<bpmn:userTask id="Prüfen"/><bpmn:userTask id="检查"/><bpmn:userTask id="{long}"/>'
        + end()
        + path("start", "Prüfen", "检查", long, "end")
    )
    nodes = read(body).scope.nodes
    found = {}
    for name in ("Prüfen", "检查", long):
        work = nodes[name].activity
        assert work is not None
        found[name] = (work.variable, work.definition)
    assert found["Prüfen"] == ("Prufen", "prufen")
    assert found["检查"][0] == "_"
    assert found["检查"][1].startswith("task-")
    assert found[long] == ("x" * 90, "x" * 100)


def test_ids_that_are_no_names_are_refused() -> None:
    wrong = "an id of letters, digits, - _ . (at most 200 characters)"
    for name in ("1a", "a b", "x" * (MAX_NODE_ID + 1)):
        found = faults(between(f'<bpmn:userTask id="{name}"/>', name))
        assert any(wrong in fault for fault in found), found


def test_ids_that_become_one_variable_are_distinguished() -> None:
    body = start() + '<bpmn:userTask id="ä"/><bpmn:userTask id="a"/>' + end() + path("start", "ä", "a", "end")
    assert any('in the variable "a_2"' in warning for warning in warnings(body))
