"""Run the web UI server: `python -m webui`."""

from handover.serving import run
from webui.server import make_app
from webui.settings import WebuiSettings

if __name__ == "__main__":
    run("webui", make_app, WebuiSettings, port_field="webui_port")
