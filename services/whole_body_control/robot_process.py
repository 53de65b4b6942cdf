"""The process of a simulated robot: python -m services.whole_body_control.robot_process DEPLOYMENT.yaml

The deployment names the robot of the kind `driver`; start this first, then the control cycle with the same
file. A driver of a physical robot would do the same with other hardware. It ends with SIGTERM or SIGINT.
"""

import argparse
import signal
import sys
from pathlib import Path
from typing import Any

from handover.errors import UsageError
from handover.telemetry import get_logger
from services.whole_body_control.behaviours.walking import WalkingSettings
from services.whole_body_control.cycle.deployment import Deployment, read_deployment
from services.whole_body_control.cycle.privileges import stop_collecting, use_real_time
from services.whole_body_control.cycle.robot_link import Driver
from services.whole_body_control.cycle.timing import Timing
from services.whole_body_control.cycle.watchdog import Safety
from services.whole_body_control.model.kinematics import Kinematics
from services.whole_body_control.robots import humanoid
from services.whole_body_control.simulation.simulated_robot import SimulatedRobot

log = get_logger(__name__)


def driver(deployment: Deployment) -> Driver:
    """Return the driver of a simulated robot that stands. Raises `UsageError`."""
    model = humanoid(deployment.robot.humanoid)
    deployment.folder.mkdir(parents=True, exist_ok=True)
    start = Kinematics(model).standing(WalkingSettings().pose)
    return Driver(SimulatedRobot(model, start), deployment.folder)


def run(deployment: Deployment) -> None:
    """Run until a signal. Raises `UsageError`."""
    running, ended = driver(deployment), list[int]()

    def end(number: int, _: Any) -> None:
        ended.append(number)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    granted = use_real_time(fifo=deployment.fifo)
    log.info("driver started", folder=str(deployment.folder), **granted)
    timing, state, refusal = Timing(running.robot.period_s), Safety.HOLDING, ""
    stop_collecting()
    while not ended:
        now = running.cycle()
        if now is not state:
            log.warning("safety changed", before=state.name, now=now.name, stalls=running.watchdog.stalls)
            state = now
        if running.refusal != refusal:
            refusal = running.refusal
            log.error("command refused", reason=refusal) if refusal else log.info("commands followed again")
        timing.wait()


def main() -> None:
    """Run the robot of the deployment that the command line names."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("deployment", type=Path, help="a YAML file")
    try:
        run(read_deployment(parser.parse_args().deployment))
    except UsageError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
