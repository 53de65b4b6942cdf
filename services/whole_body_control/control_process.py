"""The process of the control cycle: python -m services.whole_body_control.control_process DEPLOYMENT.yaml

It reads the port `wish`, and writes the port `state`, in the folder of the deployment. It ends with SIGTERM
or SIGINT, after the robot stands. Everything else may stall, end or be killed.
"""

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from handover.errors import UsageError
from handover.telemetry import get_logger
from services.whole_body_control.behaviours.walking import WalkingController
from services.whole_body_control.components.robot import JointCommand, RobotSensors
from services.whole_body_control.cycle.deployment import Deployment, read_deployment
from services.whole_body_control.cycle.loop import WISH, ControlLoop, CyclePorts, Mode, state_fields
from services.whole_body_control.cycle.ports import PortReader, PortWriter
from services.whole_body_control.cycle.privileges import stop_collecting, use_real_time
from services.whole_body_control.model.kinematics import Array
from services.whole_body_control.patterns.footsteps import Wish
from services.whole_body_control.robots import humanoid
from services.whole_body_control.simulation.simulated_robot import SimulatedRobot
from services.whole_body_control.solvers.compiled import fastest_solver
from services.whole_body_control.solvers.hierarchical import Hierarchical
from services.whole_body_control.solvers.problem import Solver

log = get_logger(__name__)

WISH_PORT, STATE_PORT = "wish", "state"
PHASES = ("standing", "double", "single")
STAND_TIMEOUT_S = 4.0
_VECTORS = ("com", "reference", "wanted_zmp", "measured_zmp")


class WalkingComponent:
    """Walking as a component of the control cycle."""

    def __init__(self, controller: WalkingController) -> None:
        self.controller = controller
        self.control_s = controller.settings.control_s
        joints = [f"joint.{name}" for name in controller.humanoid.joint_names]
        base = [f"base.{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
        planar = [f"{name}.{axis}" for name in _VECTORS for axis in "xy"]
        self.fields: Sequence[str] = ("phase", "support_left", "support_right", *planar, *base, *joints)

    def follow(self, wish: Array) -> None:
        """Walk with a velocity ahead and to the left in m/s, and a yaw rate in rad/s."""
        ahead, left, yaw_rate = wish.tolist()
        stance = self.controller.state.stance
        heading = (stance.left.yaw + stance.right.yaw) / 2
        cosine, sine = np.cos(heading), np.sin(heading)
        ground = np.array([cosine * ahead - sine * left, sine * ahead + cosine * left])
        self.controller.wish = Wish(ground, yaw_rate)

    def step(self, sensors: RobotSensors, command: JointCommand) -> str:
        """Compute the next command."""
        return self.controller.step(sensors, command).fault

    def write_state(self, state: Array) -> None:
        """Write phase, shares of the weight, places on the ground in m, and the configuration."""
        controller = self.controller
        now, estimator = controller.state, controller.estimator
        state[0] = PHASES.index(now.stance.phase)
        names = controller.settings.contacts
        state[1], state[2] = (estimator.feet[names[side]].share for side in ("left", "right"))
        state[3:5], state[5:7] = now.com[:2], now.reference.com
        state[7:9], state[9:11] = now.wanted_zmp, now.measured_zmp
        state[11:] = estimator.q


def control_loop(deployment: Deployment) -> tuple[ControlLoop[SimulatedRobot, WalkingComponent], PortReader]:
    """Return the loop of a deployment, and a reader of its state. Raises `UsageError`."""
    model = humanoid(deployment.robot.humanoid)
    solver: Solver = fastest_solver() if deployment.controller.solver == "fastest" else Hierarchical()
    controller = WalkingController(model, solver)
    component = WalkingComponent(controller)
    deployment.folder.mkdir(parents=True, exist_ok=True)
    state = PortWriter(deployment.folder / STATE_PORT, state_fields(component))
    wish = deployment.folder / WISH_PORT
    if not wish.exists():
        PortWriter(wish, WISH).close()  # a place for a writer to come
    ports = CyclePorts(PortReader(wish), state)
    if ports.wish.names != WISH:
        raise UsageError(f"the port {wish} has the values {ports.wish.names}; a wish has {WISH}")
    robot = SimulatedRobot(model, controller.start)
    loop = ControlLoop(robot, component, ports, controller.start[7:], is_paced=deployment.paced)
    return loop, PortReader(state.path)


class _End:
    """Whether a signal asked the process to end."""

    is_wanted = False

    def __call__(self, *_: Any) -> None:
        self.is_wanted = True


def run(deployment: Deployment) -> None:
    """Run until a signal, and then until the robot stands. Raises `UsageError`."""
    loop, state = control_loop(deployment)
    end = _End()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    granted = use_real_time(fifo=deployment.fifo)
    log.info("control cycle started", folder=str(deployment.folder), **granted)
    loop.warm_up()
    stop_collecting()
    is_reported = False
    while not end.is_wanted:
        loop.cycle()
        if loop.mode is Mode.HOLDING and not is_reported:
            log.error("control stopped; the joints hold the last command", reason=loop.fault)
            is_reported = True
    loop.stand()
    for _ in range(round(STAND_TIMEOUT_S / loop.robot.period_s)):
        loop.cycle()
        if loop.mode is Mode.HOLDING or (state.read() and state.value("phase") == PHASES.index("standing")):
            break
    timing = loop.timing
    log.info("control cycle ended", cycles=timing.cycles, late=timing.late, lost=timing.lost)


def main() -> None:
    """Run the deployment that the command line names."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("deployment", type=Path, help="a YAML file")
    try:
        run(read_deployment(parser.parse_args().deployment))
    except UsageError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
