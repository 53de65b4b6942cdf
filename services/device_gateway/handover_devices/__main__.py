"""Run the device gateway: `python -m handover_devices`."""

from handover.service_addresses import DEVICE_GATEWAY
from handover.serving.server import run
from handover_devices.app import make_app
from handover_devices.settings import GatewaySettings

if __name__ == "__main__":
    run(DEVICE_GATEWAY, make_app, GatewaySettings, port_field="gateway_port")
