"""Run the trajectory tool: `python -m handover_robots`."""

from handover.serving.server import run
from handover_robots.app import make_app
from handover_robots.settings import TrajectorySettings

if __name__ == "__main__":
    run("trajectory-tool", make_app, TrajectorySettings, port_field="trajectory_port")
