"""Run the ROS bridge: `python -m handover_ros`."""

from handover.service_addresses import ROS_BRIDGE
from handover.serving.server import run
from handover_ros.app import make_app
from handover_ros.settings import BridgeSettings

if __name__ == "__main__":
    run(ROS_BRIDGE, make_app, BridgeSettings, port_field="bridge_port")
