"""Figures 6c, 6d and 8 of CoSiMA from runs of ours: throws, solver times, a led walk of a minute.

The paper shows its figures without a table of their values; what can be compared is their kind and their
order. Simulated physics with sensor noise; everything but the times follows from the seed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from handover_humanoid.behaviours.rehearsal import rehearse
from handover_humanoid.behaviours.simulated_person import SCRIPTS, Lead, LedRecord, LedWalk
from handover_humanoid.behaviours.simulated_throw import SimulatedThrow, ThrowRecord
from handover_humanoid.behaviours.throwing import Practice, aimed_throw
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.patterns.intention import IntentionName
from handover_humanoid.patterns.regions import SIDES
from handover_humanoid.patterns.throwing import ThrowPlanner
from handover_humanoid.simulation.ball import build_with_ball
from handover_humanoid.simulation.simulated_robot import TYPICAL_NOISE
from handover_humanoid.solvers.compiled import fastest_solver

THROWS: Final = 10
DISTANCE_M, HEIGHT_M, SPREAD_RAD = 0.8, 0.5, 0.25
COLOURS: Final = {
    "left": "#1f6fd1",
    "right": "#c2410c",
    "com": "#111827",
    "zmp": "#b91c1c",
    "plan": "#9ca3af",
}
DPI: Final = 90
_STYLE: Final[Any] = {  # its type in matplotlib lists all names
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e5e7eb",
    "legend.frameon": False,
    "legend.fontsize": 8.0,
}


@dataclass(frozen=True, slots=True)
class ThrowFigures:
    """What the figure of the throws shows: errors in mm, solver times in microseconds."""

    errors_mm: Array
    solve_us: Array


def draw_throws(humanoid: Humanoid, file: Path, seed: int = 1, throws: int = THROWS) -> ThrowFigures:
    """Draw throws of each hand in turn, and the times of the solver meanwhile (Figures 6c and 6d).

    Targets are at 0.8 m and a height of 0.5 m in random directions; each hand has rehearsed before.
    """
    games = {hand: _throw(humanoid, hand, seed, throws) for hand in humanoid.grips}
    times_us = 1e6 * np.concatenate([record.solve_s for _, records in games.values() for record in records])
    errors = {
        hand: np.array([record.landed - target for target, record in zip(targets, records, strict=True)])
        for hand, (targets, records) in games.items()
    }
    with mpl.rc_context(_STYLE):
        figure = Figure((11, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        _draw_landings(left, errors)
        _draw_times(right, times_us)
        figure.savefig(file, dpi=DPI)
    lengths = [np.linalg.norm(error, axis=1) for error in errors.values()]
    return ThrowFigures(1e3 * np.concatenate(lengths), times_us)


def _throw(humanoid: Humanoid, hand: str, seed: int, throws: int) -> tuple[list[Array], list[ThrowRecord]]:
    random = np.random.default_rng(seed)
    game = SimulatedThrow(humanoid, build_with_ball(humanoid), fastest_solver(), TYPICAL_NOISE, seed)
    start, practice = game.controller.start, Practice()
    planner = ThrowPlanner(Kinematics(humanoid), start, humanoid.grips[hand])
    rehearse(practice, humanoid, [hand], np.array([DISTANCE_M, 0.0, HEIGHT_M]), fastest_solver())
    targets, records = list[Array](), list[ThrowRecord]()
    for _ in range(throws):
        direction = random.uniform(-SPREAD_RAD, SPREAD_RAD)
        target = np.array([DISTANCE_M * np.cos(direction), DISTANCE_M * np.sin(direction), HEIGHT_M])
        _, planned = aimed_throw(planner, practice, hand, start[:2], target)
        record = game.throw(planned)
        practice.learn(hand, start[:2], planned.landing, record.predicted)
        targets.append(target)
        records.append(record)
    return targets, records


def _draw_landings(axes: Axes, errors: Mapping[str, Array]) -> None:
    angle = np.linspace(0.0, 2 * np.pi, 100)
    for radius_mm in (20, 50):
        axes.plot(radius_mm * np.cos(angle), radius_mm * np.sin(angle), color=COLOURS["plan"], linewidth=1)
        axes.annotate(f"{radius_mm} mm", (0.0, radius_mm), fontsize=8, ha="center", va="bottom")
    for hand, error in errors.items():
        side = hand.removesuffix("_hand")
        axes.plot(-1e3 * error[:, 1], 1e3 * error[:, 0], "o", color=COLOURS.get(side), label=f"{side} hand")
        for number, (ahead, left) in enumerate(1e3 * error[:, :2], 1):
            axes.annotate(str(number), (-left, ahead), fontsize=7, xytext=(3, 3), textcoords="offset points")
    axes.set(
        title="(6c) throws of each hand to 0.8 m: landing beside the target",
        xlabel="to the right, mm",
        ylabel="farther, mm",
        aspect="equal",
        xlim=(-90, 90),
        ylim=(-62, 62),
    )
    axes.legend(loc="lower right")


def _draw_times(axes: Axes, times_us: Array) -> None:
    least, most = np.quantile(times_us, [0.0, 0.999])
    axes.hist(
        np.clip(times_us, least, most), bins=np.geomspace(least, most, 60).tolist(), color=COLOURS["left"]
    )
    axes.set(
        title=f"(6d) time of the solver, {len(times_us)} problems",
        xlabel="µs",
        ylabel="problems",
        xscale="log",
    )
    for share, name in ((0.5, "median"), (0.99, "99 %")):
        at = float(np.quantile(times_us, share))
        axes.axvline(at, color=COLOURS["right"], linewidth=1)
        axes.annotate(f" {name} {at:.0f} µs", (at, 0.93), xycoords=("data", "axes fraction"), fontsize=8)


def draw_led_walk(
    humanoid: Humanoid,
    file: Path,
    intention: IntentionName,
    seed: int = 1,
    script: Sequence[Lead] = SCRIPTS["tour"],
) -> LedRecord:
    """Draw a minute in which a simulated person leads the robot around (Figure 8)."""
    walk = LedWalk(humanoid, fastest_solver(), TYPICAL_NOISE, seed, intention=intention)
    sole = np.array(humanoid.contacts[walk.component.walking.settings.contacts["left"]].corners)[:, :2]
    record = walk.run(script)
    with mpl.rc_context(_STYLE):
        figure = Figure((11, 12), layout="constrained")
        axes = figure.subplots(4, 2)
        _draw_paths(axes[0], record)
        _draw_tracking(axes[1, 0], record)
        _draw_ground(axes[1, 1], record, sole)
        _draw_direction(axes[2, 0], record)
        _draw_manipulability(axes[2, 1], record, walk.assistance.threshold)
        _draw_speed(axes[3, 0], record)
        _draw_forces(axes[3, 1], record)
        figure.savefig(file, dpi=DPI)
    return record


def _draw_paths(pair: Sequence[Axes], record: LedRecord) -> None:
    seconds = _seconds(record)
    com = np.array([state.com[:2] for state in record.states])
    zmp = np.array([state.wanted_zmp for state in record.states])
    for index, (axes, name) in enumerate(zip(pair, ("ahead", "to the left"), strict=True)):
        for side in SIDES:
            feet = [state.stance.foot(side).place[index] for state in record.states]
            axes.plot(seconds, feet, color=COLOURS[side], linewidth=1, label=f"{side} foot")
        axes.plot(seconds, zmp[:, index], color=COLOURS["zmp"], linewidth=0.6, label="ZMP")
        axes.plot(seconds, com[:, index], color=COLOURS["com"], linewidth=1, label="centre of mass")
        axes.set(title=f"(8b) ZMP, centre of mass and feet: {name}", xlabel="s", ylabel="m")
    pair[0].legend()


def _draw_tracking(axes: Axes, record: LedRecord) -> None:
    error = np.array([state.com[:2] - state.reference.com for state in record.states])
    for index, name in enumerate(("ahead", "to the left")):
        axes.plot(_seconds(record), 1e3 * error[:, index], linewidth=0.8, label=name)
    rms_mm = 1e3 * float(np.sqrt((error**2).sum(axis=1).mean()))
    axes.set(title=f"(8c) error of the centre of mass: RMS {rms_mm:.0f} mm", xlabel="s", ylabel="mm")
    axes.legend()


def _draw_ground(axes: Axes, record: LedRecord, sole: Array) -> None:
    drawn = set()
    for state in record.states:
        for side in SIDES:
            foot = state.stance.foot(side)
            key = (side, round(foot.x, 3), round(foot.y, 3))
            if key not in drawn:
                drawn.add(key)
                axes.add_patch(
                    Polygon(foot.to_ground(sole), fill=False, edgecolor=COLOURS[side], linewidth=0.6)
                )
    com = np.array([state.com[:2] for state in record.states])
    axes.plot(com[:, 0], com[:, 1], color=COLOURS["com"], linewidth=1)
    axes.set(title="(8d) footsteps and centre of mass, from above", xlabel="m", ylabel="m", aspect="equal")


def _draw_direction(axes: Axes, record: LedRecord) -> None:
    speed = np.hypot(*record.velocity.T)
    read_rad = np.arctan2(record.velocity[:, 1], record.velocity[:, 0])
    read_rad[speed < 0.01] = np.nan
    drawn = ((record.intention, "plan", 4.0, "the person"), (read_rad, "zmp", 0.9, "what the robot read"))
    for angle, colour, width, name in drawn:
        degrees = (np.degrees(angle) + 135.0) % 360.0 - 135.0  # back is 180, without a jump near it
        axes.plot(_seconds(record), degrees, color=COLOURS[colour], linewidth=width, label=name)
    axes.set(title="(8e) walking direction", xlabel="s", ylabel="degrees from ahead to the left")
    axes.set(xlim=(0, None), ylim=(-135, 225), yticks=range(-90, 226, 45))
    axes.legend()


def _draw_manipulability(axes: Axes, record: LedRecord, threshold: float) -> None:
    for index, side in enumerate(SIDES):
        axes.plot(
            _seconds(record), 1e3 * record.manipulability[:, index], color=COLOURS[side], label=f"{side} arm"
        )
    axes.axhline(1e3 * threshold, color=COLOURS["com"], linestyle="--", linewidth=1, label="threshold")
    axes.set(title="(8f) manipulability", xlabel="s", ylabel="10⁻³ m³/rad³")
    axes.legend()


def _draw_speed(axes: Axes, record: LedRecord) -> None:
    axes.plot(_seconds(record), np.hypot(*record.velocity.T), label="speed, m/s")
    axes.plot(_seconds(record), record.yaw_rate, label="yaw rate, rad/s")
    axes.set(title="wanted velocity", xlabel="s")
    axes.legend()


def _draw_forces(axes: Axes, record: LedRecord) -> None:
    for index, side in enumerate(SIDES):
        force = np.hypot(*record.forces[:, 3 * index : 3 * index + 2].T)
        axes.plot(_seconds(record), force, color=COLOURS[side], linewidth=0.8, label=f"{side} hand")
    axes.set(title="pulls of the person", xlabel="s", ylabel="N")
    axes.legend()


def _seconds(record: LedRecord) -> Array:
    return np.asarray(record.time_s - record.time_s[0])
