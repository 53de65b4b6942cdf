"""Run whole-body control: `python -m services.whole_body_control`."""

from handover.serving import run
from services.whole_body_control.app import make_app
from services.whole_body_control.settings import WholeBodySettings

if __name__ == "__main__":
    run("whole-body-control", make_app, WholeBodySettings, port_field="whole_body_port")
