"""Run the alert router: `python -m handover_alerts`."""

from handover.service_addresses import ALERT_ROUTER
from handover.serving.server import run
from handover_alerts.app import make_app
from handover_alerts.settings import RouterSettings

if __name__ == "__main__":
    run(ALERT_ROUTER, make_app, RouterSettings, port_field="alert_router_port")
