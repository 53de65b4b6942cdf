"""What comes next: it is said before it happens, the way forward first, and nothing that cannot be."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.run import Run
from handover_bpmn.lookahead import MAX_UPCOMING, activities_after_next, upcoming_activities
from handover_bpmn.model import Definition
from services.task_orchestrator.tests.unit.drawing import (
    NOW,
    ONE_STEP,
    activity,
    boundary,
    drawing,
    end,
    flow,
    gateway,
    path,
    start,
    timer,
)
from services.task_orchestrator.tests.unit.process_driver import OneDefinition, only_process
from services.task_orchestrator.tests.unit.shapes import SHAPES, whole

BIN_PICKING = Path("services/task_orchestrator/handover_processes/processes/bin_picking.bpmn")
FORK = (
    start()
    + activity("work")
    + gateway("which", default="which_calm")
    + activity("calm")
    + activity("fast")
    + activity("slow")
    + end()
    + path("start", "work", "which", "calm", "end")
    + flow("which", "fast", "speed &gt; 5")
    + flow("which", "slow", "work.slow")
    + path("fast", "end")
    + path("slow", "end")
)


def after(definition: Definition, *waiting: str, **variables: Any) -> list[str]:
    return [each.id for each in upcoming_activities(definition, waiting, variables)]


@pytest.mark.parametrize(
    ("waiting", "ahead"),
    [
        (["confirm_clear"], ["home_before", "confirm_clear"]),
        (["confirm_pick"], ["pick", "stir_bin"]),
        (["confirm_grip"], ["place", "free_part"]),
        (["scan"], ["confirm_pick", "stir_bin", "check_view"]),
        (["check_view"], ["scan", "stir_bin", "confirm_pick", "adjust_view"]),
        (["stir_bin"], ["scan"]),
        (["pick", "pick_failed"], ["confirm_grip", "free_part"]),
        (["pick_failed", "pick"], ["confirm_grip", "free_part"]),
        (["pick"], ["confirm_grip", "free_part"]),
        (["home_after"], []),
        ([], []),
        (["no such element"], []),
    ],
)
def test_lookahead_of_bin_picking_has_the_main_path_first(waiting: list[str], ahead: list[str]) -> None:
    assert after(only_process(BIN_PICKING.read_bytes()), *waiting) == ahead


@pytest.mark.parametrize(
    ("waiting", "following"),
    [(["confirm_clear"], ["scan"]), (["confirm_pick"], ["confirm_grip", "free_part"]), (["home_after"], [])],
)
def test_the_second_step_of_bin_picking_follows_the_first(waiting: list[str], following: list[str]) -> None:
    definition = only_process(BIN_PICKING.read_bytes())
    assert [activity.id for activity in activities_after_next(definition, tuple(waiting), {})] == following


def test_the_second_step_is_decided_only_by_what_the_first_does_not_set() -> None:
    body = FORK.replace(flow("start", "work"), "") + activity("before") + path("start", "before", "work")
    fork = only_process(drawing(body))
    second = {"speed": 5, "work": {"slow": True}}
    assert [node.id for node in activities_after_next(fork, ("before",), second)] == ["calm", "slow"]
    assert [node.id for node in activities_after_next(fork, ("before",), {"speed": 6})] == ["fast"]


def test_what_the_variables_decide_already_is_decided() -> None:
    fork = only_process(drawing(FORK))
    assert after(fork, "work") == ["calm", "fast", "slow"]
    assert after(fork, "work", speed=6) == ["fast"]
    assert after(fork, "work", speed=5) == ["calm", "slow"]


def test_what_the_waiting_activity_said_last_time_decides_nothing() -> None:
    fork = only_process(drawing(FORK))
    assert after(fork, "work", speed=5, work={"slow": True}) == ["calm", "slow"]
    assert after(fork, "which", speed=5, work={"slow": True}) == ["slow"]


def test_side_by_side_only_what_nothing_sets_decides() -> None:
    body = FORK.replace(flow("start", "work"), "") + gateway("split", "parallel") + activity("beside")
    body += path("start", "split", "beside", "end") + flow("split", "work")
    fork = only_process(drawing(body))
    assert after(fork, "which", "beside", speed=6) == ["fast"]
    assert after(fork, "which", "beside", speed=5, work={"slow": True}) == ["calm", "slow"]


def test_behind_a_script_nothing_is_decided() -> None:
    script = '<bpmn:scriptTask id="faster"><bpmn:script>speed = speed + 1</bpmn:script></bpmn:scriptTask>'
    body = FORK.replace(flow("work", "which"), "") + script + path("work", "faster", "which")
    assert after(only_process(drawing(body)), "work", speed=5) == ["calm", "fast", "slow"]


def test_what_an_error_or_a_timer_leads_to_comes_last() -> None:
    body = ONE_STEP.replace(path("start", "work", "end"), "")
    body += boundary("late", "work", timer("PT1M")) + activity("remind") + activity("next")
    body += path("start", "work", "next", "end") + path("late", "remind", "end")
    assert after(only_process(drawing(body)), "late", "work") == ["next", "remind"]


def test_a_ring_of_gateways_comes_to_an_end_and_so_does_the_list() -> None:
    names = [f"a{n}" for n in range(20)]
    body = start() + gateway("join") + gateway("split", "parallel") + gateway("again", default="again_end")
    body += end() + path("start", "join", "split", "again", "end") + flow("again", "join", "go")
    body += "".join(activity(name) + path("split", name, "end") for name in names)
    definition = only_process(drawing(body))
    assert after(definition, "start") == names[:MAX_UPCOMING]


@settings(max_examples=3 * settings.default.max_examples)
@given(shape=SHAPES, go=st.booleans(), choices=st.data())
def test_every_reached_activity_was_predicted(shape: Any, go: bool, choices: st.DataObject) -> None:
    plan = Plan(only_process(drawing(whole(shape))))
    run = Run.start(plan, {"go": go}, NOW, OneDefinition(plan))
    for _ in range(25):
        if run.completed:
            break
        before = {open_.token for open_ in run.open()}
        ahead = upcoming_activities(plan.definition, run.waiting(), run.variables())
        assert len({each.id for each in ahead}) == len(ahead) <= MAX_UPCOMING
        done = choices.draw(st.sampled_from(run.open()))
        run.complete(done.token, {done.element: {"ok": choices.draw(st.booleans())}}, NOW)
        reached = {open_.element for open_ in run.open() if open_.token not in before}
        assert reached <= {each.id for each in ahead}
