"""A control session: one person moves one robot by velocities, alone or shared with an autonomous motion.

The session owns the robot: the cell is in manual mode (`ManualMode`), so that a Task and a person never
command robots of the same cell; other people may move the other robots. The control thread
asks for velocities in each cycle (`_velocity`); the event loop only stores the latest input. The motion ends
at rest when the dead-man control does not permit it, and begins again with the next permitted input.
"""

import asyncio
import time
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from handover.control.dead_man import TIMEOUT_S, DeadMan
from handover.errors import HandoverError
from handover.messages import message
from handover.runtime.control_cycle import runs_in_cycle
from handover_datamodels.streams import HumanInput
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.control.intent import IntentPrediction
from handover_robots.control.recording import Recording
from handover_robots.control.shared_control import (
    ApproachSpeeds,
    Array,
    Mixer,
    approach,
    arbitrated,
    blended,
    steers_away,
)
from handover_robots.control.tool_motion import in_base, joint_velocities, scaled
from handover_robots.driver_base.cyclic_robot import CyclicRobot
from handover_robots.metrics import CONTROL_LATENCY, CONTROL_STOP, CONTROL_STOP_BEGIN
from handover_robots.model.faults import RobotFault
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Pose
from handover_robots.scene.scene import REDUCED_SPEED_MPS

MAX_TOOL_MPS: Final = REDUCED_SPEED_MPS
"""The speed of the tool that a person commands at most."""
MAX_TOOL_RPS: Final = 1.0
MAX_JOINT_FRACTION: Final = 0.3
"""The fraction of the speed of a joint that a person commands at most."""
STEERING_S: Final = 0.1
"""The time constant that removes tremor (8 to 12 Hz) from the direction of steering."""
LIMIT_POLL_S: Final = 0.05
_TOOL_LIMITS_MPS: Final = (MAX_TOOL_MPS,) * 3
_TOOL_LIMITS_RPS: Final = (MAX_TOOL_RPS,) * 3
_REST: Final = np.zeros(6)


class RobotBusy(HandoverError):
    """The robot, or another one of the cell, performs a Task; the message names the way out."""


@dataclass(slots=True)
class SharedState:
    """What shared control does now, for display."""

    mix: float = 0.0
    goal: str | None = None
    distance_m: float | None = None
    confidence: float = 0.0
    probabilities: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class StopTimes:
    """The last stop: from its cause to its begin in the control loop, and to the rest of the robot, in s.

    The cause is the arrival of a release, or the moment at which the last input had become too old.
    """

    begin_s: float
    rest_s: float

    def written(self) -> dict[str, float]:
        """Return it as JSON, in ms."""
        return {
            "beginMs": round(self.begin_s * 1000, 1),
            "restMs": round(self.rest_s * 1000, 1),
        }


class ControlSession:
    """The control of the robot `unit`; `others` are the other robots, which perform no Task meanwhile.

    An asynchronous context manager; it raises `RobotBusy` when a robot performs a Task, or this one moves for
    another session, for longer than `patience_s`.
    """

    def __init__(
        self,
        unit: RobotUnit,
        others: tuple[RobotUnit, ...],
        *,
        gamma: float = 1.0,
        patience_s: float = 0.5,
        recording: Recording | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.unit = unit
        self.shared = SharedState()
        self.fault: str | None = None
        self.acting = False
        """Whether the gripper acts."""
        self._others = others
        self._gamma = gamma
        self._patience_s = patience_s
        self._recording = recording
        self._stop_begin: tuple[float, float] | None = None
        """Cause and begin of the present stop."""
        self._released_s = 0.0
        self.stop: StopTimes | None = None
        self._kinematics = unit.kinematics
        self._limits = [MAX_JOINT_FRACTION * limit for limit in unit.limits.velocity]
        self._now = now
        self._begun_s = now()
        self._dead_man = DeadMan()
        self._input = HumanInput(seq=0, held=False)
        self._arrived = asyncio.Event()
        self._is_ended = False
        self._intent = IntentPrediction()
        self._mixer = Mixer()
        self._steering = np.zeros(6)
        """The input without tremor, by which it is decided whether the person steers away."""
        self._goals: dict[str, Pose] = {}
        self._human = self._robot = _REST
        """The velocities of the person and of the autonomous motion in this cycle."""
        self._last_cycle_s = 0.0
        self._moved_s: float | None = None
        self._received_s = 0.0
        self.latency_s: float | None = None
        """From the arrival of the input that began the present motion to its first command."""
        self._locks = AsyncExitStack()

    async def __aenter__(self) -> "ControlSession":
        units = (self.unit, *self._others)
        locks = {unit.name: unit.in_hand for unit in units}
        try:
            await self._locks.enter_async_context(
                self.unit.manual.joined(self.unit.name, locks, self._patience_s)
            )
        except TimeoutError:
            busy = next((unit for unit in units if unit.in_hand.locked()), self.unit)
            raise RobotBusy(
                message(
                    "robot.control_busy",
                    "{robot} performs a Task; wait for its end, or cancel it, before you take control",
                    robot=busy.name,
                )
            ) from None
        await asyncio.to_thread(self._prepare)
        return self

    def _prepare(self) -> None:
        """Build models now: while they are built, the event loop receives no input in time."""
        self._kinematics.prepare()
        robot = self.unit.robot
        if isinstance(robot, CyclicRobot) and robot.limiter.needs_preparation():
            robot.limiter.prepare()

    async def __aexit__(self, *_: object) -> None:
        self.end()
        await self._locks.aclose()

    def receive(self, human_input: HumanInput) -> None:
        """Take an input. Raises `RobotFault` for joints that the robot does not have."""
        if human_input.joints is not None and len(human_input.joints) != len(self.unit.model.joints):
            raise RobotFault(
                f"joints has {len(human_input.joints)} values, and {self.unit.name} has "
                f"{len(self.unit.model.joints)} joints"
            )
        now_s = self._now()
        if self._input.held and not human_input.held:
            self._released_s = now_s
        self._input = human_input
        if human_input.gamma is not None:
            self._gamma = human_input.gamma
        self._received_s = now_s
        self._dead_man.receive(now_s, is_held=human_input.held)
        self._arrived.set()

    def silence_s(self) -> float:
        """Return the time since the last input, or since the begin."""
        return self._now() - max(self._received_s, self._begun_s)

    def end(self) -> None:
        """Bring the robot to rest; `run` returns then."""
        self._is_ended = True
        self._arrived.set()

    async def run(self) -> None:
        """Move the robot as the inputs say, until the end. The robot rests when this returns."""
        try:
            while not self._is_ended:
                self._arrived.clear()
                if not await self.advance():
                    await self._arrived.wait()
        finally:
            await self._remember()

    async def advance(self) -> bool:
        """Perform the motion that the input asks for, up to rest; return False where it asks for none."""
        if not self._is_wanted():
            return False
        if self.unit.speed.pace() <= 0:
            self._dead_man.disarm()  # after a stop a person begins the motion again
            await asyncio.sleep(LIMIT_POLL_S)
        else:
            await self._move()
        return True

    async def act(self, gripper: str, subject: str) -> None:
        """Open or close the gripper at rest. Raises `RobotFault`."""
        self.acting = True
        try:
            name = f"control:{subject}"
            if gripper == "close":
                await self.unit.grip(name, may_be_unknown=True)
            else:
                await self.unit.release(name, None)
        finally:
            self.acting = False
            self.shared = SharedState()

    async def _move(self) -> None:
        self._goals = self._present_goals()
        self._intent.set_goals(self._goals)
        self._mixer, self.shared = Mixer(), SharedState()
        self._last_cycle_s, self._moved_s, self._stop_begin = self._now(), None, None
        self._steering = np.zeros(6)
        self.unit.speed.begin_velocities(MAX_TOOL_MPS)
        try:
            is_complete = await self.unit.robot.servo(self._velocity, self._is_over, self.unit.speed.pace)
        except RobotFault as fault:
            self.fault = str(fault)
            self._dead_man.disarm()
            await asyncio.sleep(LIMIT_POLL_S)
            return
        finally:
            self.unit.speed.end_motion()
        self._measure_stop()
        self.fault = None
        if not is_complete:
            self._dead_man.disarm()
        await self._remember()

    async def _remember(self) -> None:
        try:
            await self.unit.remember()
        except OSError as error:
            self.fault = f"the state of the cell cannot be stored: {error.strerror}; free disk space"

    def _is_wanted(self) -> bool:
        human_input = self._input
        is_moving = (
            any((*human_input.linear, *human_input.angular, *(human_input.joints or ())))
            or human_input.mix > 0
        )
        return is_moving and not self.acting and self._dead_man.permits(self._now())

    def _is_over(self) -> bool:
        now_s = self._now()
        is_over = self._is_ended or self.acting or not self._dead_man.permits(now_s)
        if is_over and self._stop_begin is None:
            cause_s = self._received_s + TIMEOUT_S if self._input.held else self._released_s
            self._stop_begin = cause_s, now_s
        return is_over

    def _measure_stop(self) -> None:
        """Measure the stop that has ended, if a release or the loss of inputs was its cause."""
        if self._stop_begin is None or self._is_ended or self.acting:
            return
        cause_s, begin_s = self._stop_begin
        if cause_s <= begin_s:  # otherwise the control was pressed again meanwhile
            self.stop = StopTimes(begin_s - cause_s, self._now() - cause_s)
            CONTROL_STOP_BEGIN.observe(self.stop.begin_s)
            CONTROL_STOP.observe(self.stop.rest_s)

    @runs_in_cycle
    def _velocity(self) -> Joints:
        """Return the velocities of the joints for this cycle; called in the control thread."""
        now_s = self._now()
        dt_s, self._last_cycle_s = min(now_s - self._last_cycle_s, 0.1), now_s
        if self._moved_s is None:
            self._moved_s = now_s
            self.latency_s = now_s - self._received_s
            CONTROL_LATENCY.observe(self.latency_s)
        human_input, limits = self._input, self._limits
        joints = self.unit.robot.commanded()
        if human_input.joints is not None:
            self.shared, self._human, self._robot, twist = SharedState(), _REST, _REST, _REST
            velocities = tuple(scaled(np.array(human_input.joints) * self._gamma, limits).tolist())
        else:
            twist = self._twist(human_input, joints, dt_s)
            velocities = (0.0,) * len(joints)
            if twist.any():
                jacobian = self._kinematics.jacobian(joints)
                velocities = tuple(joint_velocities(jacobian, twist, limits).tolist())
        if self._recording is not None:
            self._record(self._recording, human_input, self._kinematics.tool_pose(joints), twist, velocities)
        return velocities

    @runs_in_cycle
    def _record(
        self, recording: Recording, human_input: HumanInput, here: Pose, twist: Array, velocities: Joints
    ) -> None:
        shared, since_s = self.shared, time.time() - self._now()
        recording.add(
            (
                round(since_s + self._last_cycle_s, 6),
                round(since_s + self._received_s, 6),
                human_input.seq,
                round(shared.mix, 4),
                human_input.mix,
                int(human_input.arbitration),
                self._gamma,
                shared.goal or "",
                "" if shared.distance_m is None else round(shared.distance_m, 5),
                *(round(float(number), 6) for number in (*self._human, *self._robot, *twist)),
                *(round(number, 6) for number in (*here.position, *here.orientation)),
                *(round(velocity, 6) for velocity in velocities),
            )
        )

    @runs_in_cycle
    def _twist(self, human_input: HumanInput, joints: Joints, dt_s: float) -> Array:
        human = np.array([*human_input.linear, *human_input.angular])
        if human_input.frame == "tool":
            human = in_base(human, self._kinematics.tool_pose(joints).frame().rotation)
        human[:3] = scaled(human[:3], _TOOL_LIMITS_MPS)
        human[3:] = scaled(human[3:], _TOOL_LIMITS_RPS)
        self._human, self._robot = human, _REST
        if human_input.mix <= 0 or not self._goals:
            self.shared = SharedState()
            return self._gamma * human
        here = self._kinematics.tool_pose(joints)
        self._steering += (human - self._steering) * min(dt_s / STEERING_S, 1.0)
        self._intent.observe(here, human, self._goals, dt_s, MAX_TOOL_MPS)
        best = self._intent.best()
        assert best is not None  # noqa: S101 - there are goals
        name, confidence = best
        goal = self._goals[name]
        robot = self._robot = approach(here, goal, ApproachSpeeds())
        effort = float(np.linalg.norm(human[:3])) / MAX_TOOL_MPS
        asked = human_input.mix
        if human_input.arbitration:
            asked = arbitrated(human_input.mix, confidence, here.distance_m(goal), effort)
        if self.shared.goal not in (None, name):
            self._mixer = Mixer()  # a change of mind begins with the person alone
        mix = self._mixer.step(asked, dt_s, is_away=steers_away(self._steering, here, goal))
        self.shared = SharedState(mix, name, here.distance_m(goal), confidence, self._intent.probabilities())
        return blended(mix, self._gamma, human, robot)

    def _present_goals(self) -> dict[str, Pose]:
        """Return the poses of the tool at the parts, or with a part in the hand at the free nests."""
        unit = self.unit
        if unit.held is None:
            return {lying.part: lying.pose for lying in unit.contents.lying}
        goals: dict[str, Pose] = {}
        for name in unit.scene.fixtures:
            nest = unit.contents.free_nest(unit.scene, name)
            if nest is not None:
                goals[name] = nest
        return goals

    def view(self) -> dict[str, Any]:
        """Return the present state for the page of the person who controls."""
        now_s = self._now()
        lowest = self.unit.speed.lowest()
        return {
            "type": "state",
            "seq": self._input.seq,
            "joints": self.unit.robot.state().written(self.unit.model.joint_names),
            "toolPose": self.unit.tool_pose.written(),
            "moves": self._dead_man.permits(now_s) and self._is_wanted(),
            "needsRelease": self._dead_man.needs_release(now_s),
            "limit": None if lowest is None else lowest.rule,
            "fault": self.fault,
            "holds": self.unit.held,
            "mix": round(self.shared.mix, 3),
            "goal": self.shared.goal,
            "goalDistanceM": None if self.shared.distance_m is None else round(self.shared.distance_m, 4),
            "goals": {name: round(share, 3) for name, share in self.shared.probabilities.items()},
            "confidence": round(self.shared.confidence, 3),
            "human": _rounded(self._human),
            "robot": _rounded(self._robot),
            "inputAgeMs": round((now_s - self._received_s) * 1000, 2),
            "stop": None if self.stop is None else self.stop.written(),
            "isRecorded": self._recording is not None and not self._recording.is_full,
            "latencyMs": None if self.latency_s is None else round(self.latency_s * 1000, 2),
        }


def _rounded(twist: Array) -> list[float]:
    return [round(float(component), 4) for component in twist]
