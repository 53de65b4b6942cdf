"""Run the gesture controller: `python -m handover_gloves`."""

from handover.service_addresses import GESTURE_CONTROLLER
from handover.serving.server import run
from handover_gloves.app import make_app
from handover_gloves.settings import ControllerSettings

if __name__ == "__main__":
    run(GESTURE_CONTROLLER, make_app, ControllerSettings, port_field="controller_port")
