"""The throws of a session: which of them are asked for again, and what ends the session."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from handover.control.limit_link import LimitLink
from handover.database import connect
from handover_humanoid.behaviours.component_state import BallPhase, Behaviour
from handover_humanoid.running.humanoid_control import HumanoidControl
from handover_humanoid.running.sessions.juggling import MAX_REFUSALS, REFUSED, Juggling
from handover_humanoid.running.store import Store
from handover_humanoid.sessions.catching import CatchRules
from handover_humanoid.sessions.difficulty import CatchingSpace, Difficulty
from handover_humanoid.sessions.exercise import EndReason, Exercise, Goal, PauseReason, State
from handover_humanoid.settings import WholeBodySettings
from tests.kit.waiting import until

REACHING = 1.0
SPACE = CatchingSpace(centre=(0.8, 0.0, 0.5), side_m=0.0, height_m=0.0)


class Game:
    """A session of throws beside a control cycle whose state the test writes."""

    def __init__(self, control: HumanoidControl) -> None:
        self.control, self.now_s = control, 0.0
        self.exercise = Exercise("juggling", Goal(throws=3), self.now_s)
        self.juggling = Juggling(Difficulty(SPACE, seed=1), CatchRules(), lambda _: None)
        control.process.problem, control.links.age_s = "", 0.0
        control.motion.behaviour = Behaviour.JUGGLING
        self.show(throw_number=0, throw_phase=0.0, ball_phase=BallPhase.NONE, robot_time_s=0.0)

    def show(self, **values: Any) -> None:
        """Let the cycle show values."""
        standing = {"behaviour": float(Behaviour.JUGGLING), "phase": 0.0, "mode": 0.0}
        self.control.links.values = {**standing, **self.control.links.values, **values}

    def tick(self, later_s: float = 10.0) -> None:
        """Let time pass, of the robot as well."""
        self.now_s += later_s
        self.show(robot_time_s=self.control.links.values["robot_time_s"] + later_s)
        self.juggling.tick(self.control, self.exercise, self.now_s)

    async def planned(self) -> int:
        """Let the session ask for a throw, and return its number when it is planned."""
        self.tick()
        number = self.juggling.number
        await until(lambda: not self.control.throws.is_pending(number), why="the throw is planned")
        return number


@pytest.fixture
async def game(tmp_path: Path) -> AsyncIterator[Game]:
    settings = WholeBodySettings.load(data_dir=tmp_path, humanoid_ports_dir=tmp_path / "ports")
    engine = connect(settings.database("whole-body-control"))
    limits = LimitLink("http://127.0.0.1:1", "coman-1", headers=dict)
    control = HumanoidControl(settings, Store(engine), limits)
    control.rehearsals.open()
    yield Game(control)
    control.throws.close()
    await control.rehearsals.close()
    engine.dispose()


async def test_a_throw_that_was_cancelled_is_made_again_and_is_no_fault_of_the_robot(game: Game) -> None:
    for _ in range(MAX_REFUSALS + 1):
        number = await game.planned()
        game.show(throw_number=number, ball_phase=BallPhase.HELD, throw_phase=REACHING)
        game.tick(1.0)
        assert game.juggling.number == number
        game.show(throw_phase=0.0)
        game.tick(0.1)
        assert game.exercise.state is State.RUNNING
    assert (await game.planned()) == number + 1


async def test_throws_that_the_robot_refuses_end_the_session(game: Game) -> None:
    for count in range(MAX_REFUSALS):
        assert game.exercise.state is State.RUNNING
        number = await game.planned()
        game.show(throw_number=number, throw_phase=REFUSED)
        game.tick(0.1)
        assert number == count + 1
    assert game.exercise.ended_by is EndReason.FAULT


async def test_neither_planning_nor_a_pause_counts_as_a_throw_that_does_not_begin(game: Game) -> None:
    game.tick()
    number = game.juggling.number
    game.tick(3600.0)  # it is still planned
    await until(lambda: not game.control.throws.is_pending(number), why="the throw is planned")
    game.exercise.pause(PauseReason.PERSON, game.now_s)
    game.tick(3600.0)
    game.exercise.clear(PauseReason.PERSON)
    game.exercise.resume(game.now_s)
    game.tick(14.0)
    assert game.juggling.number == number
    game.show(throw_number=number, ball_phase=BallPhase.FLYING, throw_phase=REACHING)
    game.tick(0.1)
    game.show(ball_phase=BallPhase.LANDED, throw_phase=0.0, **{f"ball.{axis}": 0.02 for axis in "xyz"})
    game.tick(0.5)
    (thrown,) = game.exercise.throws
    assert thrown.outcome.result == "missed"


async def test_a_ball_that_is_seen_on_the_ground_only_was_thrown(game: Game) -> None:
    number = await game.planned()
    landed = {f"ball.{axis}": 0.02 for axis in "xyz"}
    game.show(throw_number=number, ball_phase=BallPhase.LANDED, throw_phase=0.0, **landed)
    game.tick(0.1)
    game.tick(0.1)
    (thrown,) = game.exercise.throws
    assert thrown.outcome.result == "missed"
