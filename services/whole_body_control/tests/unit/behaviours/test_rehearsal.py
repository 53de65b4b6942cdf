"""Rehearsals of throws: shipped with a model, kept in a file of it, or made while the first throw waits."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handover.errors import Problem
from handover_humanoid.behaviours.component_state import Behaviour
from handover_humanoid.behaviours.rehearsal import (
    DIRECTIONS_RAD,
    FILE,
    read_rehearsals,
    write_rehearsals,
)
from handover_humanoid.behaviours.rehearsal import TARGET as REHEARSAL_TARGET
from handover_humanoid.behaviours.simulated_throw import SimulatedThrow
from handover_humanoid.behaviours.throwing import Practice
from handover_humanoid.model.kinematics import Kinematics
from handover_humanoid.patterns.throwing import ThrowPlanner
from handover_humanoid.robots import folder, humanoid
from handover_humanoid.running.motion import Motion
from handover_humanoid.running.rehearsals import Rehearsals
from handover_humanoid.running.throws import Throws
from handover_humanoid.simulation.ball import build_with_ball
from handover_humanoid.solvers.compiled import fastest_solver
from tests.kit.waiting import until

COMAN = humanoid("coman")
TARGET, FAR = (0.8, 0.1, 0.5), (2.5, 0.0, 0.5)
REHEARSED_WITHIN_S = 120.0


@asynccontextmanager
async def throws_of(*files: Path) -> AsyncIterator[tuple[Throws, Motion]]:
    motion, practice = Motion(), Practice()
    motion.behaviour = Behaviour.JUGGLING
    rehearsals = Rehearsals(COMAN, practice, files)
    rehearsals.open()
    throws = Throws(COMAN, motion, practice, rehearsals, dict)
    try:
        yield throws, motion
    finally:
        throws.close()
        await rehearsals.close()


def state(throws: Throws) -> str:
    view = throws.view()
    assert view is not None
    return str(view["state"])


@pytest.mark.parametrize("name", ["coman", "talos"])
def test_the_rehearsals_that_are_shipped_are_of_the_model_and_in_every_direction(name: str) -> None:
    """After a change of the model or the controller: handover humanoid rehearse --robot NAME."""
    model = humanoid(name)
    shipped = read_rehearsals(folder(name) / FILE, model)
    assert set(shipped) == set(model.grips)
    for learned in shipped.values():
        directions = [features[2] for features, _ in learned]
        assert directions == pytest.approx([*DIRECTIONS_RAD, 0.0], abs=0.05)


@pytest.mark.slow  # seconds of simulation
@pytest.mark.parametrize(("name", "within_m"), [("coman", 0.05), ("talos", 0.4)])
def test_a_throw_with_the_rehearsals_that_are_shipped_lands_at_its_target(name: str, within_m: float) -> None:
    """The numbers of a rehearsal are those of one processor, what they are for is not.

    TALOS turns on its feet while it throws, which magnifies the rounding errors of a processor to
    decimetres: it must stand, and the ball must fly to the side of the target. COMAN hits it.
    """
    model = humanoid(name)
    game = SimulatedThrow(model, build_with_ball(model), fastest_solver())
    base, practice = game.controller.start[:2], Practice()
    for hand, learned in read_rehearsals(folder(name) / FILE, model).items():
        practice.restore(hand, learned)
        planner = ThrowPlanner(Kinematics(model), game.controller.start, model.grips[hand])
        record = game.throw(planner.plan(practice.aim(hand, base, REHEARSAL_TARGET)))
        assert np.linalg.norm((record.landed - REHEARSAL_TARGET)[:2]) < within_m
        assert game.robot.true_configuration()[2] > 0.9 * game.controller.start[2]


def test_a_file_is_read_for_the_very_model_that_rehearsed_only(tmp_path: Path) -> None:
    path = tmp_path / "folder" / FILE
    assert read_rehearsals(path, COMAN) == {}
    learned = ((np.array([1.0, 0.0, -0.2]), np.array([0.031, -0.012])),)
    write_rehearsals(path, COMAN, {"right_hand": learned})
    ((features, miss),) = read_rehearsals(path, COMAN)["right_hand"]
    assert (features.tolist(), miss.tolist()) == ([1.0, 0.0, -0.2], [0.031, -0.012])
    assert read_rehearsals(path, replace(COMAN, drive_inertia=0.06)) == {}
    assert read_rehearsals(path, replace(COMAN, grips={})) == {}
    for broken in (b"", b"{}", path.read_bytes().replace(b"0.031", b'"far"'), b"\xff"):
        path.write_bytes(broken)
        assert read_rehearsals(path, COMAN) == {}


async def test_a_hand_whose_rehearsal_is_shipped_throws_without_one() -> None:
    async with throws_of(folder("coman") / FILE) as (throws, motion):
        number = await throws.throw(TARGET, "right")
        await until(lambda: state(throws) == "planned", why="the throw is planned")
        assert (motion.throw.number, motion.throw.hand) == (number, "right")


async def test_an_error_of_the_planner_refuses_the_throw_and_the_next_one_is_planned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with throws_of(folder("coman") / FILE) as (throws, _):
        with monkeypatch.context() as patch:
            patch.setattr(ThrowPlanner, "plan", lambda *_: np.linalg.cholesky(-np.eye(2)))
            number = throws.request(TARGET, "right")
            await until(lambda: not throws.is_pending(number), why="the planner fails")
        assert "could not be planned" in str(throws.refusal(number))
        number = throws.request(TARGET, "right")
        await until(lambda: not throws.is_pending(number), why="the throw is planned")
        assert state(throws) == "planned"


@pytest.mark.nightly
@pytest.mark.slow  # a rehearsal in a process of its own
async def test_the_first_throw_of_a_hand_is_accepted_at_once_and_follows_its_rehearsal(
    tmp_path: Path,
) -> None:
    file = tmp_path / FILE
    async with throws_of(file) as (throws, motion):
        with pytest.raises(Problem, match="farthest place on that line"):
            await throws.throw(FAR, "right")
        first = await throws.throw(TARGET, "right")
        assert (state(throws), throws.is_pending(first)) == ("preparing", True)
        with pytest.raises(Problem, match="another throw is being planned"):
            throws.request(TARGET, "left")
        motion.stop("Anna", "a break")
        throws.tick()
        assert (state(throws), throws.is_pending(first)) == ("refused", False)
        assert "Anna stopped the humanoid" in str(throws.refusal(first))
        motion.reset()
        second = await throws.throw(TARGET, "right")
        assert state(throws) == "preparing"
        await until(lambda: not throws.is_pending(second), REHEARSED_WITHIN_S, "the hand has rehearsed")
        assert (state(throws), motion.throw.number) == ("planned", second)
        await until(lambda: "right_hand" in read_rehearsals(file, COMAN), why="it is kept")
    async with throws_of(file) as (throws, _):
        third = await throws.throw(TARGET, "right")
        assert not throws.is_pending(third)
