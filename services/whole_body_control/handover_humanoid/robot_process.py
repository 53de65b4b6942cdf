"""The process of a robot: python -m handover_humanoid.robot_process DEPLOYMENT.yaml

The deployment names the robot of the kind `driver`, its driver (`simulated`, `ros2`, or one of another
package) and the options of that; start this first, then the control cycle with the same file. It ends with
SIGTERM or SIGINT.
"""

import argparse
import sys
from pathlib import Path

from handover.errors import UsageError
from handover.telemetry import get_logger
from handover_humanoid.cycle.deployment import Deployment, read_deployment
from handover_humanoid.cycle.ending import EndBySignal
from handover_humanoid.cycle.privileges import stop_collecting, use_real_time
from handover_humanoid.cycle.robot_link import Driver
from handover_humanoid.cycle.timing import Timing
from handover_humanoid.cycle.watchdog import Safety
from handover_humanoid.drivers import DriverContext, make_robot
from handover_humanoid.robots import humanoid

log = get_logger(__name__)


def driver(deployment: Deployment) -> Driver:
    """Return the driver of a deployment. Raises `UsageError`."""
    robot = deployment.robot
    deployment.folder.mkdir(parents=True, exist_ok=True)
    made = make_robot(robot.driver, DriverContext(humanoid(robot.humanoid), robot.options))
    return Driver(made, deployment.folder)


def run(deployment: Deployment) -> None:
    """Run until a signal. Raises `UsageError`."""
    running, end = driver(deployment), EndBySignal()
    granted = use_real_time(fifo=deployment.fifo)
    log.info("driver started", folder=str(deployment.folder), **granted)
    timing, state, refusal = Timing(running.robot.period_s), Safety.HOLDING, ""
    stop_collecting()
    while not end.is_wanted:
        now = running.cycle()
        if now is not state:
            log.warning("safety changed", before=state.name, now=now.name, stalls=running.watchdog.stalls)
            state = now
        if running.refusal != refusal:
            refusal = running.refusal
            log.error("command refused", reason=refusal) if refusal else log.info("commands followed again")
        timing.wait()
    running.robot.close()


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
