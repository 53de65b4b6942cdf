"""A service that is killed between the intent and the outcome of an act."""

import os
import signal
from typing import Final

from fastapi import FastAPI

from handover.database import connect
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard, require
from handover.security.permissions import Permission
from handover.serving.server import serve
from handover.serving.service import create_app
from handover.settings import Settings

PORT: Final = int(os.environ["LAMP_PORT"])


def make_app(settings: Settings) -> FastAPI:
    trail = AuditTrail(settings, "lamp", connect(settings.database("lamp")))
    app = create_app("Lamp", description="for tests", guard=Guard(settings, "lamp"), audit=trail)

    @app.post("/robots/{robot}/move", dependencies=[require(Permission.MOVE_ROBOTS)])
    async def move(robot: str, is_killed: bool) -> str:
        if is_killed:
            os.kill(os.getpid(), signal.SIGKILL)
        return robot

    return app


if __name__ == "__main__":
    loaded = Settings.load()
    serve(lambda: make_app(loaded), loaded, service="lamp", port=PORT, port_setting="LAMP_PORT")
