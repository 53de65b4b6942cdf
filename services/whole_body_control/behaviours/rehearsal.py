"""Rehearsal: the first throws of a hand are made in a simulation of the robot's own model.

A hand that was never used misses by some centimetres, since its drives lag behind the plan and the feet give
way. Most of this follows from the model, so `Practice` learns it before the first ball.
"""

from collections.abc import Iterable

import numpy as np

from services.whole_body_control.behaviours.simulated_throw import SimulatedThrow
from services.whole_body_control.behaviours.throwing import Practice
from services.whole_body_control.model.humanoid import Humanoid
from services.whole_body_control.model.kinematics import Array, Kinematics
from services.whole_body_control.patterns.throwing import OutOfReach, ThrowPlanner
from services.whole_body_control.simulation.ball import build_with_ball
from services.whole_body_control.solvers.problem import Solver

DIRECTIONS_RAD = (0.0, -0.2, 0.2, -0.1, 0.1)
"""From the direction of the target; that itself is rehearsed first and last."""


def rehearse(
    practice: Practice,
    humanoid: Humanoid,
    grips: Iterable[str],
    target: Array,
    solver: Solver | None = None,
) -> None:
    """Let each hand throw to `target` (3,) in the frame of the robot, and as far and high to both sides of
    it.

    A direction that a hand cannot reach is left out. Each throw takes about half a second of CPU time.
    """
    game = SimulatedThrow(humanoid, build_with_ball(humanoid), solver)
    base = game.controller.start[:2]
    distance_m = float(np.linalg.norm(target[:2] - base))
    ahead = float(np.arctan2(target[1] - base[1], target[0] - base[0]))
    for name in grips:
        planner = ThrowPlanner(Kinematics(humanoid), game.controller.start, humanoid.grips[name])
        for offset in (*DIRECTIONS_RAD, 0.0):
            angle = ahead + offset
            way = distance_m * np.array([np.cos(angle), np.sin(angle)])
            place = np.array([*(base + way), target[2]])
            try:
                throw = planner.plan(practice.aim(name, base, place))
            except OutOfReach:
                continue
            practice.learn(name, base, throw.landing, game.throw(throw).landed)
