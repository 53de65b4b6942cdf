"""The machine of the service: options, a model only after consent, a log that lasts, safe ends."""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr
from sqlalchemy import Engine

from handover.control.speed_limits import Allowed
from handover.database import connect
from handover.errors import Problem, UsageError
from handover_cases.machine import MachineContext, Seen
from handover_cases.machines.treadmill.case import CASE, TreadmillMachine
from handover_cases.machines.treadmill.coach import Advice, Decision, Reason
from handover_cases.machines.treadmill.session_log import SessionLog
from handover_cases.machines.treadmill.wording import LANGUAGES, request_of
from handover_cases.model.body import Body, Reading
from handover_cases.settings import AssistiveSettings
from services.assistive_devices.tests.unit.treadmill.completions import Completions, obedient, serving
from tests.kit.waiting import until

STEP_S = 0.05
FREE = Allowed("body", 1.0, reason="the heart rate is normal")


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    made = connect(AssistiveSettings(data_dir=tmp_path).database("assistive-devices"))
    yield made
    made.dispose()


@asynccontextmanager
async def machine(engine: Engine, **settings: Any) -> AsyncIterator[TreadmillMachine]:
    """Yield a machine that writes its log and words decisions, as in the service."""
    made = TreadmillMachine()
    made.prepare(MachineContext(AssistiveSettings(**settings), engine))
    working = asyncio.create_task(made.work())
    await made.saved()
    try:
        yield made
    finally:
        working.cancel()
        await asyncio.gather(working, return_exceptions=True)


class Clock:
    """Steps a machine faster than life."""

    def __init__(self, made: TreadmillMachine) -> None:
        self.made, self.now_s = made, time.monotonic()

    def run(self, seconds: float, bpm: float | None = 75.0, allowed: Allowed = FREE) -> TreadmillMachine:
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            known = {} if bpm is None else {"heartRate": Reading(bpm, self.now_s)}
            self.made.step(Seen(self.now_s, STEP_S, Body(known), allowed))
        return self.made


def trainer(made: TreadmillMachine) -> Any:
    return made.describe()["trainer"]


async def worded(made: TreadmillMachine, count: int) -> list[dict[str, Any]]:
    """Return the interventions as soon as `count` of them have words."""
    await until(lambda: len(trainer(made)["interventions"]) >= count, why="the words")
    found: list[dict[str, Any]] = trainer(made)["interventions"]
    return found


def begin(made: TreadmillMachine, **options: object) -> Clock:
    clock = Clock(made)
    clock.run(0.1)
    made.configure(options)
    made.start()
    return clock


async def test_a_training_is_coached_logged_and_shown_again_after_a_restart(engine: Engine) -> None:
    async with machine(engine) as made:
        clock = begin(made, durationS=70, intensity="light", language="de")
        clock.run(31)
        await worded(made, 1)
        clock.run(30)
        shown = await worded(made, 2)
        assert [(one["advice"], one["source"]) for one in shown] == [("faster", "template")] * 2
        assert shown[0]["textCode"] == "trainer.faster.first"
        assert trainer(made)["timeLeftS"] == pytest.approx(9, abs=0.5)
        assert made.acts()["walkingMps"] > 0.5
        clock.run(15)
        await made.saved()
        assert str(made.state().reason) == "the training is over"
    row = SessionLog(engine).sessions()[0]
    assert (row.end_reason, row.language, row.consents_to_model) == ("time", "de", False)
    assert row.distance_m == pytest.approx(45, abs=15)
    async with machine(engine) as again:
        texts = [one["text"] for one in await worded(again, 2)]
    assert texts == [one["text"] for one in shown]


async def test_a_model_words_only_after_consent_and_learns_of_nobody(engine: Engine) -> None:
    with serving(Completions(obedient)) as server:
        model = {
            "trainer_model_url": server.url,
            "trainer_model_name": "m",
            "trainer_model_key": SecretStr("k"),
        }
        async with machine(engine, **model, trainer_model_timeout_s=20) as made:
            clock = begin(made, durationS=100)
            clock.run(31, bpm=71.375)
            assert (await worded(made, 1))[0]["source"] == "template"
            assert server.bodies == []
            made.stop()
            clock.run(5)
            made.configure({"durationS": 100, "consentsToModel": True, "language": "fi"})
            made.start()
            clock.run(31, bpm=71.375)
            assert (await worded(made, 1))[0]["text"] == "Hienoa, kävele hieman nopeammin!"
    possible = [
        request_of(Decision(advice, Reason.INSIDE, 0.0), language, "m")
        for advice in Advice
        for language in LANGUAGES
    ]
    assert len(server.bodies) == 1
    assert all(body in possible for body in server.bodies)
    assert "71" not in json.dumps(server.bodies)
    assert [row.consents_to_model for row in SessionLog(engine).sessions()] == [True, False]


async def test_a_hanging_model_delays_neither_belt_nor_log(engine: Engine) -> None:
    with serving(Completions(hangs=True)) as server:
        model = {"trainer_model_url": server.url, "trainer_model_name": "m", "trainer_model_timeout_s": 20.0}
        async with machine(engine, **model) as made:
            clock = begin(made, durationS=300, consentsToModel=True)
            clock.run(31)
            await until(lambda: len(server.bodies) == 1, why="the request")
            clock.run(30)
            await made.saved()
            log = SessionLog(engine)
            rows = log.interventions(log.sessions()[0].id)
            assert [(row.number, row.text) for row in rows] == [(1, None), (2, None)]
            assert made.state().is_moving
            server.released.set()
            shown = await worded(made, 2)
            assert {one["source"] for one in shown} == {"template"}


async def test_options_that_cannot_be_are_refused(engine: Engine) -> None:
    async with machine(engine) as made:
        for options in (
            {"durationS": 5},
            {"durationS": "100"},
            {"consentsToModel": 1},
            {"intensity": "sprint"},
            {"language": "sv"},
            {"pace": 3},
        ):
            with pytest.raises(Problem) as refused:
                made.configure(options)
            assert refused.value.status == 422
            assert next(iter(options)) in str(refused.value.detail)
        with pytest.raises(Problem, match="no language model is set"):
            made.configure({"consentsToModel": True})
        begin(made).run(1)
        with pytest.raises(Problem, match="still moves"):
            made.start()


def test_settings_of_a_model_that_cannot_be_are_refused(engine: Engine) -> None:
    wrong = AssistiveSettings(trainer_model_url="http://models.example.org/v1", trainer_model_name="m")
    with pytest.raises(UsageError, match="must begin with https://"):
        TreadmillMachine().prepare(MachineContext(wrong, engine))


async def test_a_heart_rate_that_ends_and_a_limit_of_nothing_stop_the_belt(engine: Engine) -> None:
    async with machine(engine) as made:
        clock = begin(made)
        clock.run(20)
        fast = made.training.belt.speed_mps
        clock.run(4, bpm=None, allowed=Allowed("body", 0.25, reason="no valid heart rate for 5 s"))
        assert made.training.belt.speed_mps == pytest.approx(0.25 * 1.3, abs=0.01)
        stopped = clock.run(3, bpm=None, allowed=Allowed("body", 0.0, reason="stopped", needs_reset=True))
        assert fast > 0.5
        assert (stopped.state().state, stopped.state().reason) == ("stopped", "stopped")
        await made.saved()
    assert SessionLog(engine).sessions()[0].end_reason == "limit"


def test_the_person_of_the_case_is_the_one_of_the_study() -> None:
    from handover_body.model.cardiovascular import Physiology

    body = Physiology.of_age(55)
    assert CASE.sensors[0].settings["max_bpm"] == pytest.approx(body.max_bpm)
    assert CASE.sensors[0].settings["rest_bpm"] == body.rest_bpm
    assert CASE.sensors[0].settings["vo2_max"] == pytest.approx(body.vo2_max, abs=0.1)
