"""Run the device gateway: `python -m services.device_gateway`."""

from handover.serving import run
from services.device_gateway.app import make_app
from services.device_gateway.settings import GatewaySettings

if __name__ == "__main__":
    run("device-gateway", make_app, GatewaySettings, port_field="gateway_port")
