"""Rehearsal: the first throws of a hand are made in a simulation of the robot's own model.

A hand that was never used misses by some centimetres, since its drives lag behind the plan and the feet give
way. Most of this follows from the model, so `Practice` learns it before the first ball.

What a hand has learned is kept in a file, which is of use to the same model only: a digest shows it. The
folder of a model may have one (`handover humanoid rehearse` writes it), so that nobody waits for it.
"""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from pydantic import Field, FiniteFloat, ValidationError

from handover.files.durable_files import replace_durably
from handover.formats.validation import ClosedModel
from handover_humanoid.behaviours.simulated_throw import SimulatedThrow
from handover_humanoid.behaviours.throwing import Practice
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.patterns.throwing import OutOfReach, ThrowPlanner
from handover_humanoid.simulation.ball import build_with_ball
from handover_humanoid.solvers.compiled import fastest_solver
from handover_humanoid.solvers.problem import Solver

DIRECTIONS_RAD = (0.0, -0.2, 0.2, -0.1, 0.1)
"""From the direction of the target; that itself is rehearsed first and last."""
TARGET: Final = np.array([0.8, 0.0, 0.5])
"""Where a hand rehearses to throw, in m, unless something else is wanted: within the reach of every hand."""
FILE: Final = "rehearsal.json"
PLACES: Final = 5

Throws = tuple[tuple[Array, Array], ...]
"""What `Practice` knows of the throws of a hand."""


def rehearse(
    practice: Practice,
    humanoid: Humanoid,
    grips: Iterable[str],
    target: Array = TARGET,
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


def rehearsed(humanoid: Humanoid, grip: str) -> Throws:
    """Return what a hand learns from its rehearsal, after some seconds of CPU time."""
    practice = Practice()
    rehearse(practice, humanoid, [grip], solver=fastest_solver())
    return practice.throws(grip)


def write_rehearsals(path: Path, humanoid: Humanoid, throws: Mapping[str, Throws]) -> None:
    """Keep what hands have learned, by grip. Raises `OSError`."""
    rounded = {
        grip: [(features.round(PLACES).tolist(), miss.round(PLACES).tolist()) for features, miss in learned]
        for grip, learned in throws.items()
    }
    file = _File(digest=_digest(humanoid), throws=rounded)
    replace_durably(path, file.model_dump_json().encode() + b"\n")


def read_rehearsals(path: Path, humanoid: Humanoid) -> dict[str, Throws]:
    """Return what the hands of this very model have learned, by grip; nothing without a file of it."""
    try:
        file = _File.model_validate_json(path.read_bytes())
    except (OSError, ValidationError):
        return {}
    if file.digest != _digest(humanoid):
        return {}
    return {
        grip: tuple((np.array(features), np.array(miss)) for features, miss in learned)
        for grip, learned in file.throws.items()
        if grip in humanoid.grips
    }


class _File(ClosedModel):
    digest: str
    throws: dict[
        str,
        Annotated[
            list[tuple[tuple[FiniteFloat, FiniteFloat, FiniteFloat], tuple[FiniteFloat, FiniteFloat]]],
            Field(max_length=Practice.KEPT),
        ],
    ]


def _digest(humanoid: Humanoid) -> str:
    """Return the digest of everything in the model that a throw depends on."""
    parts = (
        humanoid.urdf,
        humanoid.srdf,
        humanoid.joints,
        sorted(humanoid.contacts.items()),
        sorted(humanoid.grips.items()),
        humanoid.drive_inertia,
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]
