"""Run the gesture controller: `python -m services.gesture_controller`."""

from handover.serving import run
from services.gesture_controller.app import make_app
from services.gesture_controller.settings import ControllerSettings

if __name__ == "__main__":
    run("gesture-controller", make_app, ControllerSettings, port_field="controller_port")
