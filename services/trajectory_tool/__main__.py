"""Run the trajectory tool: `python -m services.trajectory_tool`."""

from handover.serving import run
from services.trajectory_tool.app import make_app
from services.trajectory_tool.settings import TrajectorySettings

if __name__ == "__main__":
    run("trajectory-tool", make_app, TrajectorySettings, port_field="trajectory_port")
