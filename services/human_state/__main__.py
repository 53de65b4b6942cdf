"""Run human state: `python -m services.human_state`."""

from handover.serving import run
from services.human_state.app import make_app
from services.human_state.settings import HumanStateSettings

if __name__ == "__main__":
    run("human-state", make_app, HumanStateSettings, port_field="human_state_port")
