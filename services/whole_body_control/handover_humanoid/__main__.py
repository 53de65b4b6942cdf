"""Run whole-body control: `python -m handover_humanoid`."""

from handover.serving.server import run
from handover_humanoid.app import make_app
from handover_humanoid.settings import WholeBodySettings

if __name__ == "__main__":
    run("whole-body-control", make_app, WholeBodySettings, port_field="whole_body_port")
