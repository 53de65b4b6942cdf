"""Run the alert router: `python -m services.alert_router`."""

from handover.serving import run
from services.alert_router.app import make_app
from services.alert_router.settings import RouterSettings

if __name__ == "__main__":
    run("alert-router", make_app, RouterSettings, port_field="alert_router_port")
