"""Run human state: `python -m handover_body`."""

import os

from fastapi import FastAPI

from handover.service_addresses import HUMAN_STATE
from handover.serving.server import run
from handover.telemetry import get_logger
from handover_body.app import make_app
from handover_body.settings import HumanStateSettings

log = get_logger(__name__)


def use_niceness(niceness: int) -> bool:
    """Ask for a niceness of this process; return whether it was granted. Threads begun later have it, too."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    except (AttributeError, OSError) as error:
        log.info("the priority stays as it is", niceness=niceness, reason=str(error))
        return False
    return True


def make_urgent_app(settings: HumanStateSettings) -> FastAPI:
    """Return the application in a process that other work delays as little as the system permits."""
    use_niceness(settings.health_niceness)
    return make_app(settings)


if __name__ == "__main__":
    run(HUMAN_STATE, make_urgent_app, HumanStateSettings, port_field="human_state_port")
