"""Run assistive devices: `python -m handover_cases`."""

from handover.service_addresses import ASSISTIVE_DEVICES
from handover.serving.server import run
from handover_cases.app import make_app
from handover_cases.settings import AssistiveSettings

if __name__ == "__main__":
    run(ASSISTIVE_DEVICES, make_app, AssistiveSettings, port_field="assistive_port")
