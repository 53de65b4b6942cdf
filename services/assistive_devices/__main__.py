"""Run assistive devices: `python -m services.assistive_devices`."""

from handover.serving import run
from services.assistive_devices.app import make_app
from services.assistive_devices.settings import AssistiveSettings

if __name__ == "__main__":
    run("assistive-devices", make_app, AssistiveSettings, port_field="assistive_port")
