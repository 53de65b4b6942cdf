"""Run the device gateway: `python -m handover_devices`."""

from handover.serving.server import run
from handover_devices.app import make_app
from handover_devices.settings import GatewaySettings

if __name__ == "__main__":
    run("device-gateway", make_app, GatewaySettings, port_field="gateway_port")
