"""A humanoid with a ball in simulation: a hand holds it, opens, and the ball flies, bounces and rolls.

A hand without finger joints holds the ball by a constraint between the ball and the place between its plates;
opening ends the constraint. For `CLEAR_S` the ball does not touch the robot, as if the fingers opened at
once; afterwards it does. Air drag is left out.
"""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from handover_humanoid.model.humanoid import Grip, Humanoid
from handover_humanoid.model.kinematics import Array
from handover_humanoid.simulation.body_model import ROBOT, STEP_S, STIFF, build
from handover_humanoid.simulation.simulated_robot import QUIET, SensorNoise, SimulatedRobot

RADIUS_M, MASS_KG = 0.025, 0.06
CLEAR_S = 0.1
BALL = "ball"
HELD_BY, HELD_IN = "held by:", "held in:"


@dataclass(frozen=True, slots=True)
class BallState:
    """Position (3,) in m and velocity (3,) in m/s of the ball, and the hand that holds it, if any."""

    position: Array
    velocity: Array
    held_by: str


class RobotWithBall(SimulatedRobot):
    """The simulated robot, and a ball that its hands can hold. Not thread-safe."""

    def __init__(
        self, humanoid: Humanoid, q: Array, noise: SensorNoise = QUIET, seed: int = 0, model: Any = None
    ) -> None:
        if model is None:
            model = build_with_ball(humanoid)
        self._held_by = ""
        self._clear_until_s = -np.inf
        self._geom = model.geom(BALL).id
        self._q_ball = int(model.joint(BALL).qposadr[0])
        self._v_ball = int(model.joint(BALL).dofadr[0])
        super().__init__(humanoid, q, noise, seed, model)

    def place(self, q: Array) -> None:
        """Put the robot at rest; the ball lies on the ground, out of the way."""
        super().place(q)
        self.put_ball(np.array([-3.0, 0.0, RADIUS_M]), np.zeros(3))

    def put_ball(self, position: Array, velocity: Array) -> None:
        """Let the ball fly from a position (3,) with a velocity (3,); a hand that holds it opens."""
        self._open()
        self._set_ball(position, velocity)

    def hold(self, grip: Grip) -> None:
        """Put the ball into a hand, at rest in it."""
        self._open()
        self._held_by = grip.name
        self._touch_robot(False)
        site = self._data.site(HELD_BY + grip.name)
        velocity = np.zeros(6)
        kind = mujoco.mjtObj.mjOBJ_SITE
        mujoco.mj_objectVelocity(self.model, self._data, kind, site.id, velocity, 0)
        self._set_ball(site.xpos, velocity[3:])
        self._data.eq_active[self.model.equality(HELD_BY + grip.name).id] = 1

    def release(self) -> None:
        """Open the hand that holds the ball."""
        self._open()
        self._clear_until_s = self._data.time + CLEAR_S

    def wait(self) -> None:
        """Simulate one period."""
        if not self._held_by and self._data.time > self._clear_until_s:
            self._touch_robot(True)
        super().wait()

    @property
    def ball(self) -> BallState:
        """Return the state of the ball."""
        data = self._data
        position = data.qpos[self._q_ball : self._q_ball + 3].copy()
        return BallState(position, data.qvel[self._v_ball : self._v_ball + 3].copy(), self._held_by)

    def ball_from_root(self) -> Array:
        """Return where the ball is (3,) in m in the frame of the root link."""
        data = self._data
        rotation = data.xmat[self._root].reshape(3, 3)
        ball = data.qpos[self._q_ball : self._q_ball + 3]
        return np.asarray(rotation.T @ (ball - data.xpos[self._root]))

    def _set_ball(self, position: Array, velocity: Array) -> None:
        data = self._data
        data.qpos[self._q_ball : self._q_ball + 7] = [*position, 1.0, 0.0, 0.0, 0.0]
        data.qvel[self._v_ball : self._v_ball + 6] = [*velocity, 0.0, 0.0, 0.0]
        mujoco.mj_forward(self.model, data)

    def _open(self) -> None:
        if self._held_by:
            self._data.eq_active[self.model.equality(HELD_BY + self._held_by).id] = 0
            self._held_by = ""

    def _touch_robot(self, does: bool) -> None:
        self.model.geom_conaffinity[self._geom] = ROBOT if does else 0


def build_with_ball(humanoid: Humanoid, ground_friction: float = 1.0) -> Any:
    """Return the MuJoCo model of a humanoid with a ball that each of its grips can hold."""

    def add(spec: Any) -> None:
        _add_ball(spec)
        for grip in humanoid.grips.values():
            _add_grip(spec, grip)

    return build(humanoid, ground_friction, add)


def _add_ball(spec: Any) -> None:
    body = spec.worldbody.add_body(name=BALL, pos=[-3.0, 0.0, RADIUS_M])
    body.add_freejoint(name=BALL)
    body.add_geom(
        name=BALL,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[RADIUS_M, 0.0, 0.0],
        mass=MASS_KG,
        contype=ROBOT,
        conaffinity=0,
        condim=6,
        friction=[0.6, 0.003, 0.0002],
        solref=[2 * STEP_S, 0.4],
    )
    body.add_site(name=HELD_IN)


def _add_grip(spec: Any, grip: Grip) -> None:
    spec.body(grip.link).add_site(name=HELD_BY + grip.name, pos=list(grip.point))
    spec.add_equality(
        name=HELD_BY + grip.name,
        type=mujoco.mjtEq.mjEQ_CONNECT,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        name1=HELD_BY + grip.name,
        name2=HELD_IN,
        active=False,
        solref=list(STIFF),
    )
