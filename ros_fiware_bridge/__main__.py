"""Run the ROS bridge: `python -m ros_fiware_bridge`."""

from handover.serving import run
from ros_fiware_bridge.app import make_app
from ros_fiware_bridge.settings import BridgeSettings

if __name__ == "__main__":
    run("ros-bridge", make_app, BridgeSettings, port_field="bridge_port")
