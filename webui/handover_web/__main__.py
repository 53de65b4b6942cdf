"""Run the web UI server: `python -m handover_web`."""

from handover.service_addresses import WEBUI
from handover.serving.server import run
from handover_web.app import make_app
from handover_web.settings import WebuiSettings

if __name__ == "__main__":
    run(WEBUI, make_app, WebuiSettings, port_field="webui_port")
