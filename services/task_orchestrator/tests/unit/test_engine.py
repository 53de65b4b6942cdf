"""The engine: tokens move as the drawing says, survive a restart at every point, and never run Python."""

import re
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.run import Run
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import read_bpmn
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
from services.task_orchestrator.tests.unit.process_driver import OneDefinition

ERROR = "<bpmn:errorEventDefinition{}/>"


class RunDriver:
    """A run that is written down and read again after every step, as after a crash."""

    def __init__(self, body: str, beside: str = "", **variables: Any) -> None:
        (definition,) = read_bpmn(drawing(body, beside=beside)).definitions
        self.plan = Plan(definition)
        self.library = OneDefinition(self.plan)
        self.now: datetime = NOW
        self.run = self._again(Run.start(self.plan, variables, NOW, self.library))

    def _again(self, run: Run) -> Run:
        again = Run.resume(self.plan, run.snapshot(), self.library)
        assert again.open() == run.open()
        assert again.waiting() == run.waiting()
        assert again.variables() == run.variables()
        assert again.next_due() == run.next_due()
        return again

    @property
    def open(self) -> list[str]:
        return sorted(f"{each.element}-{each.visit}" for each in self.run.open())

    @property
    def incident(self) -> str:
        """Return the reason of the only incident."""
        (incident,) = self.run.incidents()
        return incident.reason

    def _token(self, name: str) -> str:
        return next(each.token for each in self.run.open() if f"{each.element}-{each.visit}" == name)

    def done(self, name: str, **results: Any) -> "RunDriver":
        self.run.complete(self._token(name), results, self.now)
        self.run = self._again(self.run)
        return self

    def failed(self, name: str, code: str | None = None) -> bool:
        caught = self.run.fail(self._token(name), code, "slipped", self.now)
        self.run = self._again(self.run)
        return caught

    def after(self, **time: float) -> "RunDriver":
        self.now += timedelta(**time)
        self.run.advance(self.now)
        self.run = self._again(self.run)
        return self


def test_a_process_of_one_step_waits_for_it_and_ends() -> None:
    driver = RunDriver(ONE_STEP, colour="red")
    assert driver.open == ["work-1"]
    assert driver.run.open()[0].variables == {"colour": "red"}
    driver.done("work-1", work={"grip": 3})
    assert driver.run.completed
    assert driver.run.variables() == {"colour": "red", "work": {"grip": 3}}


CHOICE = (
    start()
    + activity("scan")
    + gateway("found", default="found_stir")
    + activity("stir")
    + activity("pick")
    + end()
    + path("start", "scan", "found", "stir", "scan")
    + flow("found", "pick", "scan.found")
    + flow("pick", "end")
)


def test_a_gateway_goes_by_the_result_and_a_loop_counts_its_visits() -> None:
    driver = RunDriver(CHOICE)
    driver.done("scan-1", scan={"found": False})
    assert driver.open == ["stir-1"]
    driver.done("stir-1").done("scan-2", scan={"found": True})
    assert driver.open == ["pick-1"]
    driver.done("pick-1")
    assert driver.run.completed


def test_a_loop_costs_the_same_however_often_it_is_walked() -> None:
    driver = RunDriver(CHOICE)
    sizes = []
    for visit in range(1, 400):
        driver.done(f"scan-{visit}", scan={"found": False}).done(f"stir-{visit}")
        sizes.append(len(driver.run.snapshot()))
    assert max(sizes[100:]) <= max(sizes[:100]) + 200
    driver.done("scan-400", scan={"found": True}).done("pick-1")
    assert driver.run.completed


def test_a_gateway_without_a_way_out_fails_by_name() -> None:
    body = (
        start()
        + gateway("g")
        + end()
        + end("other")
        + flow("start", "g")
        + flow("g", "end", "x == 1")
        + flow("g", "other", "x == 2")
    )
    assert re.search('"g".*x == 1.*x == 2', RunDriver(body, x=3).incident)


def test_a_condition_on_a_missing_variable_fails_by_name() -> None:
    driver = RunDriver(CHOICE).done("scan-1", scan={})
    assert re.search(r'at "found".*there is no "found"', driver.incident)


PARALLEL = (
    start()
    + gateway("fork", "parallel")
    + activity("left")
    + activity("right")
    + activity("middle")
    + gateway("join", "parallel")
    + activity("after")
    + end()
    + flow("start", "fork")
    + "".join(flow("fork", way) + flow(way, "join") for way in ("left", "right", "middle"))
    + path("join", "after", "end")
)


@pytest.mark.parametrize(
    "order", [("left", "right", "middle"), ("middle", "right", "left"), ("right", "left", "middle")]
)
def test_parallel_ways_are_open_together_and_join_once(order: tuple[str, ...]) -> None:
    driver = RunDriver(PARALLEL)
    assert driver.open == ["left-1", "middle-1", "right-1"]
    for way in order:
        assert "after-1" not in driver.open
        driver.done(f"{way}-1", **{way: 1})
    assert driver.open == ["after-1"]
    driver.done("after-1")
    assert driver.run.completed
    assert driver.run.variables() == {"left": 1, "middle": 1, "right": 1}


def test_parallel_ways_in_a_loop_join_every_time() -> None:
    body = PARALLEL.replace(flow("start", "fork"), path("start", "merge", "fork")).replace(
        path("join", "after", "end"), path("join", "after", "more")
    )
    body += gateway("merge") + gateway("more", default="more_merge")
    driver = RunDriver(body + flow("more", "merge") + flow("more", "end", "after.stop"))
    for round_ in range(1, 30):
        for way in ("right", "middle", "left"):
            driver.done(f"{way}-{round_}")
        driver.done(f"after-{round_}", after={"stop": round_ == 29})
    assert driver.run.completed


def test_an_inclusive_gateway_takes_every_way_whose_condition_holds() -> None:
    body = (
        start()
        + gateway("g", "inclusive", default="g_none")
        + activity("a")
        + activity("b")
        + activity("none")
        + gateway("j", "inclusive")
        + end()
        + flow("start", "g")
        + flow("g", "a", "x &gt; 1")
        + flow("g", "b", "x &gt; 2")
        + flow("g", "none")
        + flow("a", "j")
        + flow("b", "j")
        + flow("none", "j")
        + flow("j", "end")
    )
    both = RunDriver(body, x=3)
    assert both.open == ["a-1", "b-1"]
    assert not both.done("a-1").run.completed
    assert both.done("b-1").run.completed
    assert RunDriver(body, x=2).open == ["a-1"]
    assert RunDriver(body, x=0).open == ["none-1"]


CAUGHT = ONE_STEP + boundary("any", "work", ERROR.format("")) + activity("help") + path("any", "help", "work")


def test_a_failed_activity_goes_to_its_error_boundary_event() -> None:
    driver = RunDriver(CAUGHT)
    assert driver.failed("work-1")
    assert driver.open == ["help-1"]
    assert driver.run.variables()["error"] == {"activity": "work", "code": None, "reason": "slipped"}
    driver.done("help-1")
    assert driver.open == ["work-2"]
    assert driver.done("work-2").run.completed


def test_an_error_code_chooses_its_boundary_event_and_the_one_without_takes_the_rest() -> None:
    body = (
        CAUGHT
        + boundary("jam", "work", ERROR.format(' errorRef="e"'))
        + activity("clear")
        + path("jam", "clear", "end")
    )
    beside = '<bpmn:error id="e" errorCode="JAM"/>'
    driver = RunDriver(body, beside)
    assert driver.failed("work-1", "JAM")
    assert driver.open == ["clear-1"]
    other = RunDriver(body, beside)
    assert other.failed("work-1", "OTHER")
    assert other.open == ["help-1"]


def test_a_failed_activity_that_nobody_catches_is_said_to_be_so() -> None:
    body = ONE_STEP + boundary("jam", "work", ERROR.format(' errorRef="e"')) + flow("jam", "end")
    driver = RunDriver(body, '<bpmn:error id="e" errorCode="JAM"/>')
    assert not driver.failed("work-1", "OTHER")
    assert driver.open == []
    assert driver.incident == "slipped"


def test_an_error_end_event_fails_the_process() -> None:
    body = start() + activity("work") + end("bad", ERROR.format("")) + path("start", "work", "bad")
    driver = RunDriver(body).done("work-1")
    assert 'error end event "bad"' in str(driver.run.failure)
    assert driver.open == []


def test_a_terminate_end_event_ends_every_way() -> None:
    body = (
        start()
        + gateway("fork", "parallel")
        + activity("a")
        + activity("b")
        + end()
        + end("stop", "<bpmn:terminateEventDefinition/>")
        + flow("start", "fork")
        + flow("fork", "a")
        + flow("fork", "b")
        + flow("a", "stop")
        + flow("b", "end")
    )
    driver = RunDriver(body).done("a-1")
    assert driver.run.completed
    assert driver.open == []


def catch(name: str, text: str) -> str:
    return f'<bpmn:intermediateCatchEvent id="{name}">{timer(text)}</bpmn:intermediateCatchEvent>'


@pytest.mark.parametrize("text", ["PT90S", "2026-05-04T08:01:30Z", "pause", "'PT' + seconds + 'S'"])
def test_a_timer_uses_the_given_time(text: str) -> None:
    body = start() + catch("wait", text) + activity("work") + end() + path("start", "wait", "work", "end")
    driver = RunDriver(body, pause="PT90S", seconds="90")
    assert driver.run.next_due() == NOW + timedelta(seconds=90)
    assert driver.run.waiting() == ("wait",)
    assert driver.after(seconds=89).open == []
    assert driver.after(seconds=1).open == ["work-1"]
    assert driver.run.next_due() is None


def test_a_timer_in_a_loop_restarts_in_each_iteration() -> None:
    body = start() + catch("wait", "PT10S") + activity("work") + gateway("g", default="g_wait") + end()
    driver = RunDriver(body + path("start", "wait", "work", "g", "wait") + flow("g", "end", "work.stop"))
    for visit in (1, 2, 3):
        assert driver.run.next_due() == driver.now + timedelta(seconds=10)
        driver.after(seconds=10).done(f"work-{visit}", work={"stop": False})


def test_a_timer_that_is_no_time_fails_by_name() -> None:
    body = start() + catch("wait", "pause") + end() + path("start", "wait", "end")
    assert "PT5M" in RunDriver(body, pause=90).incident


LATE = ONE_STEP + activity("remind") + end("reminded") + path("late", "remind", "reminded")


def test_an_interrupting_timer_takes_the_activity_away() -> None:
    driver = RunDriver(LATE + boundary("late", "work", timer("PT1M"))).after(seconds=60)
    assert driver.open == ["remind-1"]
    assert driver.done("remind-1").run.completed


def test_a_non_interrupting_timer_leaves_the_activity_open() -> None:
    driver = RunDriver(LATE + boundary("late", "work", timer("PT1M"), interrupting=False)).after(seconds=60)
    assert driver.open == ["remind-1", "work-1"]
    driver.done("work-1")
    assert driver.open == ["remind-1"]
    assert driver.done("remind-1").run.completed


def test_an_activity_done_in_time_stops_its_timer() -> None:
    driver = RunDriver(LATE + boundary("late", "work", timer("PT1M"))).done("work-1")
    assert driver.run.completed
    assert driver.run.next_due() is None


def script(text: str) -> str:
    return f'<bpmn:scriptTask id="count"><bpmn:script>{text}</bpmn:script></bpmn:scriptTask>'


def test_a_script_sets_variables_in_our_language() -> None:
    body = start() + script("tries = tries + 1\ntwice = tries * 2") + end() + path("start", "count", "end")
    assert RunDriver(body, tries=1).run.variables() == {"tries": 2, "twice": 4}


def test_a_loop_that_never_waits_is_stopped() -> None:
    body = (
        start()
        + script("n = n + 1")
        + gateway("g", default="g_count")
        + end()
        + path("start", "count", "g", "count")
    )
    assert "without waiting" in RunDriver(body + flow("g", "end", "n &lt; 0"), n=0).incident


def test_a_value_that_doubles_in_a_loop_is_stopped() -> None:
    driver = RunDriver(
        start()
        + script("n = [n, n]")
        + gateway("g", default="g_work")
        + activity("work")
        + end()
        + path("start", "count", "g", "work", "count")
        + flow("g", "end", "false"),
        n=1,
    )
    for visit in range(1, 100):
        if not driver.open:
            break
        driver.done(f"work-{visit}")
    assert "holds at most" in driver.incident


HOSTILE = "__import__('pathlib').Path('{}').touch()"


@pytest.fixture
def forbidden_builtins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python's evaluators raise while the engine runs."""

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("Python was evaluated")

    for name in ("eval", "exec"):
        monkeypatch.setattr(f"builtins.{name}", refuse)


@pytest.mark.usefixtures("forbidden_builtins")
def test_no_python_is_evaluated_for_gateways_timers_scripts_and_parameters() -> None:
    body = (
        start()
        + script("tries = 1")
        + gateway("g", default="g_end")
        + catch("wait", "pause")
        + activity("work", '<handover:parameter name="x" expression="tries"/>')
        + boundary("late", "work", timer("pause"))
        + end()
        + path("start", "count", "g", "end")
        + flow("g", "wait", "tries == 1")
        + path("wait", "work", "end")
        + flow("late", "end")
    )
    driver = RunDriver(body, pause="PT1S").after(seconds=1)
    assert driver.open == ["work-1"]
    assert driver.after(seconds=1).run.completed


@pytest.mark.parametrize(
    "body",
    [
        start() + script(HOSTILE) + end() + path("start", "count", "end"),
        start() + catch("wait", HOSTILE) + end() + path("start", "wait", "end"),
        start() + gateway("g") + end() + path("start", "g") + flow("g", "end", HOSTILE),
    ],
    ids=["script", "timer", "gateway"],
)
def test_python_is_refused_when_the_file_is_read(body: str, tmp_path: Path) -> None:
    touched = tmp_path / "touched"
    with pytest.raises(BadBpmn):
        read_bpmn(drawing(body.replace("{}", str(touched))))
    assert not touched.exists()


def test_results_that_look_like_the_engines_own_records_stay_plain_data() -> None:
    odd = {"typename": "BpmnWorkflow", "id": "x", "data": {"typename": "UUID", "value": "no"}}
    body = ONE_STEP.replace(flow("work", "end"), "") + activity("more") + path("work", "more", "end")
    driver = RunDriver(body)
    driver.done("work-1", work=odd)
    assert driver.run.open()[0].variables["work"] == odd
