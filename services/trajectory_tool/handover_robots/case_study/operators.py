"""Operators of the case study: what the person at the input device does, 50 times a second.

`Supervisor` holds the dead-man control at m = 1, closes the gripper when the loop reports that the goal is
reached, and opens it at the next goal. It sees nothing of the scene, and has one attempt.

`Person` steers by what is seen, and tries again when a grip has failed. The parameters, with their sources:

- Reaction: the scene is seen `DELAY_S` late, and the velocity is `GAIN_PER_S` times the error that is seen:
  the crossover model of manual control of a plant that integrates (McRuer and Jex, 1967: effective delays of
  0.2 to 0.4 s). The gain is below the crossover frequencies given there: people are careful near objects.
- Tremor: 8 to 12 Hz (Elble and Koller, 1990: physiological tremor), `TREMOR_M` at the hand.
- Noise in proportion to the command (Harris and Wolpert, 1998); 15 % is our choice.
- Errors of perception: our choice, for a camera picture without stereo. They are drawn for each attempt,
  larger in depth, grow with the distance between tool and object, and do not vanish at it.
- Goal: of cloth, a person who shares control first goes where the autonomous motion goes; else, and after a
  grip that failed, to a place where the fingers seem to find room.
- Correction: a person sees after a short lift whether the grip holds; else opens, rises and aims again.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from handover_robots.case_study.seen import FingerTarget, SeenObject
from handover_robots.model.poses import Frame, Pose, Vector

Message = dict[str, Any]
Phase = Callable[[Frame, FingerTarget, bool, float], dict[str, Any]]
"""Returns the message for what is seen: the tool, the object, whether it is held; and the time."""

EVERY_S: Final = 0.02
RELEASED_S: Final = 0.1
"""The control is released for this long before it is held, as the dead-man function requires."""

DELAY_S: Final = 0.25
GAIN_PER_S: Final = 1.5
MAX_MPS: Final = 0.12
MAX_RPS: Final = 0.5
TREMOR_M: Final = 0.0001
TREMOR_HZ: Final = (8.0, 12.0)
NOISE_SHARE: Final = 0.15
NOISE_S: Final = 0.2
LATERAL_M, LATERAL_SHARE = 0.003, 0.04
DEPTH_M, DEPTH_SHARE = 0.005, 0.06
"""Standard deviations of perception: at the object, and for each m of distance from it."""
YAW_DEG: Final = 5.0

ABOVE_M: Final = 0.07
LIFT_M: Final = 0.07
CARRY_M: Final = 0.20
ABOVE_RIM_M: Final = 0.14
MAX_CARRY_M: Final = 0.55
"""The height over the box: what hangs down is carried above its rim, as far as the arm reaches."""
ALIGNED_M: Final = 0.008
ALIGNED_RAD: Final = 0.12
AT_HEIGHT_M: Final = 0.004
DECIDE_S: Final = 0.3
STALLED_S: Final = 3.0
"""A person who does not come nearer for this long closes the gripper where it is."""

REACHED_M: Final = 0.0007
PLACED_M: Final = 0.015


@dataclass(slots=True)
class View:
    """What the state of the loop shows, and where the tool is."""

    tool: Frame
    goal_distance_m: float | None
    holds: str | None
    needs_release: bool


class DeadManControl:
    """When the control is held: from the begin, and after a stop once the operator has noticed it."""

    def __init__(self) -> None:
        self._noticed_s: float | None = None
        self._pressed_s: float | None = None
        self.stops = 0

    def is_released(self, view: View, now_s: float) -> bool:
        """Return whether the operator releases the control now."""
        if self._pressed_s is None:
            self._pressed_s = now_s + RELEASED_S
        if not view.needs_release:
            self._noticed_s = None
        elif self._noticed_s is None:
            self._noticed_s = now_s
        elif now_s > self._noticed_s + DELAY_S:
            self._noticed_s, self._pressed_s = None, now_s + RELEASED_S
            self.stops += 1
        return now_s < self._pressed_s


class Supervisor:
    """Holds the dead-man control of an autonomous motion."""

    def __init__(self) -> None:
        self.attempts = 1
        self.outcome: str | None = None
        self._control = DeadManControl()
        self._best_m, self._best_s = math.inf, -math.inf
        self._has_held = False

    def acted(self, view: View, now_s: float) -> None:
        """Continue after the gripper has acted."""
        self._best_m, self._best_s = math.inf, now_s
        if self._has_held:
            self.outcome = "released"
        elif view.holds is None:
            self.outcome = "nothing gripped"
        self._has_held = True

    def next(self, view: View, now_s: float) -> Message:
        """Return the next message."""
        if self._best_s == -math.inf:
            self._best_s = now_s
        if self._control.is_released(view, now_s):
            return {"held": False}
        distance_m = math.inf if view.goal_distance_m is None else view.goal_distance_m
        if distance_m < self._best_m - 0.001:
            self._best_m, self._best_s = distance_m, now_s
        is_there = distance_m < (PLACED_M if self._has_held else REACHED_M)
        if is_there or now_s > self._best_s + STALLED_S:
            return {"held": True, "mix": 1.0, "gripper": "open" if self._has_held else "close"}
        return {"held": True, "mix": 1.0}


class Person:
    """Steers to the object and to the box by what is seen; `mix` is the largest share of the robot.

    `offered` is the grasp to which the autonomous motion goes, None without.
    """

    def __init__(
        self,
        thing: SeenObject,
        box: Vector,
        mix: float,
        random: np.random.Generator,
        offered: Pose | None = None,
    ) -> None:
        self.attempts = 0
        self.outcome: str | None = None
        self._thing, self._box, self._mix, self._random = thing, box, mix, random
        self._seen: deque[tuple[float, Frame, FingerTarget, bool]] = deque()
        self._control = DeadManControl()
        self._stops = 0
        self._phase: Phase = self._to_above
        self._since_s = 0.0
        self._best_m, self._best_s = math.inf, 0.0
        self._tremor_hz = float(random.uniform(*TREMOR_HZ))
        self._tremor = random.normal(size=3)
        self._noise = np.zeros(4)
        self._lift_from_m = 0.0
        self._aim(offered)

    def acted(self, view: View, now_s: float) -> None:  # noqa: ARG002
        """Continue after the gripper has acted."""
        self._seen.clear()
        following: dict[Phase, Phase] = {
            self._close: self._lift,
            self._open: self._to_above,
            self._let_go: self._leave,
        }
        self._begin(following[self._phase], now_s)

    def next(self, view: View, now_s: float) -> Message:
        """Return the next message."""
        self._seen.append((now_s, view.tool, self._thing.target(), self._thing.is_between_fingers()))
        while len(self._seen) > 1 and self._seen[1][0] <= now_s - DELAY_S:
            self._seen.popleft()
        if self._control.is_released(view, now_s):
            if self._control.stops > self._stops:  # the fingers met something
                self._stops = self._control.stops
                if self._phase == self._down:
                    self._aim()
                    self._begin(self._to_above, now_s)
            return {"held": False}
        _, tool, target, is_held = self._seen[0]
        return {"held": True, **self._phase(tool, target, is_held, now_s)}

    def _begin(self, phase: Phase, now_s: float) -> None:
        self._phase, self._since_s = phase, now_s
        self._best_m, self._best_s = math.inf, now_s

    def _aim(self, offered: Pose | None = None) -> None:
        """Look at the object: the errors of this attempt."""
        self.attempts += 1
        self._thing.look(offered)
        self._error = self._random.normal(size=3)
        self._yaw_error = math.radians(YAW_DEG) * float(self._random.normal())

    def _believed(self, tool: Frame, tips: Vector) -> Any:
        """Return where the person believes a place to be."""
        distance_m = math.dist(tool.position, tips)
        lateral = LATERAL_M + LATERAL_SHARE * distance_m
        depth = DEPTH_M + DEPTH_SHARE * distance_m
        return np.array(tips) + self._error * (lateral, lateral, depth)

    def _to_above(self, tool: Frame, target: FingerTarget, is_held: bool, now_s: float) -> Message:  # noqa: ARG002
        believed = self._believed(tool, target.tips)
        way = np.add(believed, (0.0, 0.0, ABOVE_M)) - tool.position
        turn = self._turn(tool, target)
        height_m = tool.position[2] - believed[2]
        if math.hypot(way[0], way[1]) > 0.03 and height_m < ABOVE_M / 2:
            way[:2] = 0.0  # up first
        elif math.hypot(way[0], way[1]) < ALIGNED_M and abs(turn) < ALIGNED_RAD:
            self._begin(self._down, now_s)
        return self._steer(way, turn, now_s)

    def _down(self, tool: Frame, target: FingerTarget, is_held: bool, now_s: float) -> Message:  # noqa: ARG002
        way = self._believed(tool, target.tips) - tool.position
        distance_m = float(np.linalg.norm(way))
        if distance_m < self._best_m - 0.002:
            self._best_m, self._best_s = distance_m, now_s
        if math.hypot(way[0], way[1]) > 2.5 * ALIGNED_M and way[2] < -0.03:
            self._begin(self._to_above, now_s)
        elif way[2] > -AT_HEIGHT_M or now_s > self._best_s + STALLED_S:
            self._begin(self._close, now_s)
        return self._steer(way, self._turn(tool, target), now_s)

    def _close(self, tool: Frame, target: FingerTarget, is_held: bool, now_s: float) -> Message:  # noqa: ARG002
        self._lift_from_m = tool.position[2]
        rest = self._steer(np.zeros(3), 0.0, now_s, mix=0.0)
        return {**rest, "gripper": "close"} if now_s > self._since_s + DECIDE_S else rest

    def _lift(self, tool: Frame, target: FingerTarget, is_held: bool, now_s: float) -> Message:  # noqa: ARG002
        left_m = self._lift_from_m + LIFT_M - tool.position[2]
        if left_m < 0.01 or now_s > self._since_s + STALLED_S:
            self._begin(self._carry if is_held else self._open, now_s)
        return self._steer(np.array([0.0, 0.0, left_m + 0.02]), 0.0, now_s, mix=0.0)

    def _open(self, tool: Frame, target: FingerTarget, is_held: bool, now_s: float) -> Message:  # noqa: ARG002
        if now_s < self._since_s + DECIDE_S:
            return self._steer(np.zeros(3), 0.0, now_s, mix=0.0)
        self._aim()
        return {**self._steer(np.zeros(3), 0.0, now_s, mix=0.0), "gripper": "open"}

    def _carry(self, tool: Frame, target: FingerTarget, is_held: bool, now_s: float) -> Message:
        if not is_held:
            self._begin(self._open, now_s)
        way = np.subtract(self._box, tool.position)
        hangs_m = tool.position[2] - target.bottom_m
        way[2] = min(max(CARRY_M, ABOVE_RIM_M + hangs_m), MAX_CARRY_M) - tool.position[2]
        if way[2] > 0.05:
            way[:2] = 0.0
        elif math.hypot(way[0], way[1]) < 0.02:
            self._begin(self._let_go, now_s)
        return self._steer(way, 0.0, now_s)

    def _let_go(self, tool: Frame, target: FingerTarget, is_held: bool, now_s: float) -> Message:  # noqa: ARG002
        rest = self._steer(np.zeros(3), 0.0, now_s, mix=0.0)
        return {**rest, "gripper": "open"} if now_s > self._since_s + DECIDE_S else rest

    def _leave(self, tool: Frame, target: FingerTarget, is_held: bool, now_s: float) -> Message:  # noqa: ARG002
        self.outcome = "released"
        return self._steer(np.zeros(3), 0.0, now_s, mix=0.0)

    def _turn(self, tool: Frame, target: FingerTarget) -> float:
        """Return by how much the tool seems to have to turn about z; both directions of closing are alike."""
        if target.closing_rad is None:
            return 0.0
        closing = math.atan2(tool.rotation[1][1], tool.rotation[0][1])  # the fingers close along y
        return (target.closing_rad + self._yaw_error - closing + math.pi / 2) % math.pi - math.pi / 2

    def _steer(self, way: Any, turn: float, now_s: float, mix: float | None = None) -> Message:
        linear = GAIN_PER_S * np.asarray(way, dtype=float)
        linear *= min(1.0, MAX_MPS / max(float(np.linalg.norm(linear)), 1e-9))
        angular = min(max(GAIN_PER_S * turn, -MAX_RPS), MAX_RPS)
        fading = math.exp(-EVERY_S / NOISE_S)
        self._noise = fading * self._noise + math.sqrt(1 - fading**2) * self._random.normal(size=4)
        omega = 2 * math.pi * self._tremor_hz
        tremor = TREMOR_M * omega * math.cos(omega * now_s) * self._tremor
        linear = linear * (1 + NOISE_SHARE * self._noise[:3]) + tremor
        angular *= 1 + NOISE_SHARE * float(self._noise[3])
        return {
            "linear": linear.tolist(),
            "angular": [0.0, 0.0, angular],
            "mix": self._mix if mix is None else mix,
            "arbitration": True,
        }


Operator = Supervisor | Person


def view_of(shown: dict[str, Any]) -> View:
    """Return what an operator uses of the state of a control session."""
    written = shown["toolPose"]
    pose = Pose(tuple(written["position"]), tuple(written["orientation"]))
    return View(pose.frame(), shown["goalDistanceM"], shown["holds"], shown["needsRelease"])
