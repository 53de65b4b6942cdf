"""The process of the control cycle: python -m handover_humanoid.control_process DEPLOYMENT.yaml

It reads the ports `wish`, `person` and `gains`, and writes the port `state`, in the folder of the deployment.
It ends with SIGTERM or SIGINT, after the robot stands. Everything else may stall, end or be killed.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from handover.errors import UsageError
from handover.telemetry import get_logger
from handover_humanoid.behaviours.component_state import PHASES
from handover_humanoid.behaviours.humanoid_component import HumanoidComponent
from handover_humanoid.behaviours.walking import WalkingSettings
from handover_humanoid.components.robot import Robot
from handover_humanoid.cycle.deployment import Deployment, read_deployment
from handover_humanoid.cycle.ending import EndBySignal
from handover_humanoid.cycle.gains import gain_fields
from handover_humanoid.cycle.loop import ControlLoop, CyclePorts, state_fields
from handover_humanoid.cycle.ports import PortReader, PortWriter
from handover_humanoid.cycle.privileges import stop_collecting, use_real_time
from handover_humanoid.cycle.robot_link import PortRobot
from handover_humanoid.cycle.wish import PERSON, WISH
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.ball import RobotWithBall
from handover_humanoid.simulation.body_model import STEP_S
from handover_humanoid.simulation.simulated_robot import SimulatedRobot
from handover_humanoid.solvers.compiled import fastest_solver
from handover_humanoid.solvers.hierarchical import Hierarchical
from handover_humanoid.solvers.problem import Solver

log = get_logger(__name__)

WISH_PORT, PERSON_PORT, GAINS_PORT, STATE_PORT = "wish", "person", "gains", "state"
STAND_TIMEOUT_S = 4.0


def _robot(deployment: Deployment, model: Humanoid, start: Array) -> Robot:
    """Return the robot of a deployment. Raises `UsageError`."""
    if deployment.robot.kind == "driver":
        return PortRobot(model, deployment.folder, STEP_S)
    return RobotWithBall(model, start) if model.grips else SimulatedRobot(model, start)


def control_loop(
    deployment: Deployment,
) -> tuple[ControlLoop[Any, HumanoidComponent], PortReader]:
    """Return the loop of a deployment, and a reader of its state. Raises `UsageError`."""
    model = humanoid(deployment.robot.humanoid)
    solver: Solver = fastest_solver() if deployment.controller.solver == "fastest" else Hierarchical()
    start = Kinematics(model).standing(WalkingSettings().pose)
    robot = _robot(deployment, model, start)
    world = robot if isinstance(robot, RobotWithBall) else None
    controller = deployment.controller
    component = HumanoidComponent(
        model, solver, world, engine=controller.engine, intention=controller.intention
    )
    deployment.folder.mkdir(parents=True, exist_ok=True)
    state = PortWriter(deployment.folder / STATE_PORT, state_fields(component))
    ports = CyclePorts(
        _to_read(deployment.folder / WISH_PORT, WISH),
        _to_read(deployment.folder / PERSON_PORT, PERSON),
        _to_read(deployment.folder / GAINS_PORT, gain_fields(model)),
        state,
    )
    loop = ControlLoop(
        robot,
        component,
        ports,
        component.start[7:],
        is_paced=deployment.paced,
        mode=deployment.controller.mode,
    )
    return loop, PortReader(state.path)


def _to_read(path: Path, names: Sequence[str]) -> PortReader:
    """Return the reader of a port that another process writes; it is made here, as a place for a writer."""
    if not path.exists():
        PortWriter(path, names).close()
    port = PortReader(path)
    if port.names != tuple(names):
        raise UsageError(f"the port {path} has the values {port.names}; {path.name} has {tuple(names)}")
    return port


def run(deployment: Deployment) -> None:
    """Run until a signal, and then until the robot stands. Raises `UsageError`."""
    loop, state = control_loop(deployment)
    end = EndBySignal()
    granted = use_real_time(fifo=deployment.fifo)
    log.info("control cycle started", folder=str(deployment.folder), **granted)
    stop_collecting()  # takes a tenth of a second and more, so before the schedule begins
    loop.warm_up()
    is_reported = False
    while not end.is_wanted:
        loop.cycle()
        if loop.mode.is_final and not is_reported:
            log.error("control stopped; the joints hold the last command", reason=loop.fault)
            is_reported = True
    loop.stand()
    for _ in range(round(STAND_TIMEOUT_S / loop.robot.period_s)):
        loop.cycle()
        if loop.mode.is_final or (state.read() and state.value("phase") == PHASES.index("standing")):
            break
    loop.robot.close()
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
