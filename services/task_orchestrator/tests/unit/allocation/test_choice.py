"""The choice among agents: who is suitable, who is available, and who is best."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_processes.allocation.agents import Agent, Position, Skill, read_agents
from handover_processes.allocation.choice import ChooseByRules, Request, WaitingRequest

MONDAY = datetime(2026, 5, 4, 10, 0, tzinfo=UTC)


def entity(kind: str, name: str, **attributes: Any) -> dict[str, Any]:
    made: dict[str, Any] = {"id": f"urn:ngsi-ld:{kind}:demo:{name}", "type": kind}
    for each, value in attributes.items():
        made[each] = {"type": "Property", "value": value}
    return made


def specified(specified_entity: dict[str, Any], **attributes: Any) -> list[dict[str, Any]]:
    name = f"{specified_entity['id'].rpartition(':')[2]}-kind"
    specification = entity("ResourceSpecification", name, **attributes)
    link = {"type": "Relationship", "object": specification["id"]}
    return [{**specified_entity, "isSpecifiedBy": link}, specification]


def agent(name: str, level: float = 1, **values: Any) -> Agent:
    return Agent(f"urn:ngsi-ld:Device:demo:{name}", skills={"grip": Skill(level)}, **values)


def busy(*names: str) -> dict[str, list[str]]:
    return {f"urn:ngsi-ld:Device:demo:{name}": ["urn:ngsi-ld:Task:demo:other"] for name in names}


GRIP = Request(skills=("grip",))


def test_agents_have_the_skills_of_their_specification() -> None:
    known = read_agents(
        [
            *specified(
                entity("Device", "ur10-1", deviceState="idle", relativePosition=[1, 2, 3]),
                skills=["grip", {"name": "place", "level": 3, "cost": 2, "speed": 0.5}],
                capacity=2,
            ),
            *specified(entity("Person", "ada", roles=["operator"]), roles=["visitor"], capacity="many"),
            entity("Location", "bin-1", relativePosition=[1, 2, 7]),
        ]
    )
    robot = known.by_id["urn:ngsi-ld:Device:demo:ur10-1"]
    assert robot.skills == {"grip": Skill(), "place": Skill(3, 2, 0.5)}
    assert (robot.capacity, robot.is_person, robot.unavailable) == (2, False, None)
    person = known.by_id["urn:ngsi-ld:Person:demo:ada"]
    assert (person.roles, person.capacity, person.is_person) == (frozenset({"operator"}), 1, True)
    place = known.places["urn:ngsi-ld:Location:demo:bin-1"]
    assert robot.position is not None
    assert robot.position.distance_m(place) == 4


@pytest.mark.parametrize(
    ("moment", "works"),
    [
        (datetime(2026, 5, 4, 21, 59, tzinfo=UTC), True),  # 23:59 in Berlin
        (datetime(2026, 5, 4, 19, 59, tzinfo=UTC), False),
        (datetime(2026, 5, 5, 3, 59, tzinfo=UTC), True),  # 05:59 on the next day
        (datetime(2026, 5, 5, 4, 0, tzinfo=UTC), False),
    ],
)
def test_a_night_shift_ends_on_the_next_day(moment: datetime, works: bool) -> None:
    shift = {"weekday": 1, "from": "22:00", "to": "06:00", "zone": "Europe/Berlin"}
    (person,) = read_agents([entity("Person", "ada", shifts=[shift, {"weekday": 9}])]).by_id.values()
    assert person.works_at(moment) is works


def test_the_reason_names_the_chosen_agent_and_the_others() -> None:
    near, far = Position((0.0, 0.0)), Position((4.0, 0.0))
    agents = [agent("ur10-1", 1, position=near), agent("ur10-2", 3, position=far)]
    request = Request(skills=("grip",), place=near)
    choice = ChooseByRules().choose(request, agents, busy("ur10-1"), {}, MONDAY)
    assert choice.reason == "ur10-2: idle, skill 3, 4 m away; ur10-1 is busy"


@pytest.mark.parametrize(
    ("agents", "loads", "chosen"),
    [
        ([agent("a", 1), agent("b", 2)], {}, "b"),
        ([agent("a", 1), agent("b", 2, capacity=2)], busy("b"), "a"),
        ([agent("a", 1), agent("b", 2, unavailable="error")], {}, "a"),
        ([agent("a", 1), agent("b", 2)], busy("a", "b"), None),
        ([Agent("urn:ngsi-ld:Device:demo:a")], {}, None),
    ],
)
def test_load_comes_before_skill(
    agents: list[Agent], loads: dict[str, list[str]], chosen: str | None
) -> None:
    choice = ChooseByRules().choose(GRIP, agents, loads, {}, MONDAY)
    assert choice.agent == (chosen and f"urn:ngsi-ld:Device:demo:{chosen}")


def test_the_nearer_of_equal_agents_is_chosen() -> None:
    agents = [agent("a", position=Position((9.0, 0.0))), agent("b", position=Position((1.0, 0.0)))]
    request = Request(skills=("grip",), place=Position((0.0, 0.0)))
    assert ChooseByRules().choose(request, agents, {}, {}, MONDAY).agent == agents[1].id


def test_an_unconfirmed_mapping_chooses_no_robot() -> None:
    request = Request(skills=("grip",), people_only=True)
    assert ChooseByRules().choose(request, [agent("a")], {}, {}, MONDAY).agent is None


def test_a_request_is_refused_only_when_all_suitable_agents_have_declined() -> None:
    agents = [agent("a"), agent("b")]
    once = Request(skills=("grip",), declined=frozenset({agents[0].id}))
    waits = ChooseByRules().choose(once, agents, busy("b"), {}, MONDAY)
    assert (waits.agent, waits.is_final) == (None, False)
    twice = Request(skills=("grip",), declined=frozenset(each.id for each in agents))
    choice = ChooseByRules().choose(twice, agents, {}, {}, MONDAY)
    assert (choice.agent, choice.is_final) == (None, True)


REQUESTS = st.builds(
    Request,
    skills=st.sampled_from([("grip",), ("place",), ("grip", "place")]),
    priority=st.integers(0, 3),
)
AGENTS = st.lists(
    st.builds(
        lambda skills, capacity: (skills, capacity),
        st.sampled_from([("grip",), ("place",), ("grip", "place")]),
        st.integers(1, 2),
    ),
    min_size=1,
    max_size=4,
)


@given(AGENTS, st.lists(REQUESTS, max_size=12))
def test_everybody_who_can_be_served_is_served_and_nobody_has_too_much(
    kinds: list[tuple[tuple[str, ...], int]], requests: list[Request]
) -> None:
    agents = [
        Agent(f"agent:{n}", skills=dict.fromkeys(skills, Skill()), capacity=capacity)
        for n, (skills, capacity) in enumerate(kinds)
    ]
    waiting = [
        WaitingRequest(request, MONDAY + timedelta(seconds=n), ("p", str(n)))
        for n, request in enumerate(requests)
        if any(request.suits(each) for each in agents)
    ]
    served = 0
    expected = len(waiting)
    while waiting:
        loads: dict[str, list[str]] = {}
        before: list[WaitingRequest] = []
        for each in sorted(waiting, key=lambda one: one.order):
            choice = ChooseByRules().choose(each.request, agents, loads, {}, MONDAY)
            if choice.agent is None:
                before.append(each)
            else:
                loads.setdefault(choice.agent, []).append(each.key[1])
        assert loads, "nobody was served although all agents were free"
        for one in agents:
            assert len(loads.get(one.id, [])) <= one.capacity
        served += sum(map(len, loads.values()))
        waiting = before
    assert served == expected
