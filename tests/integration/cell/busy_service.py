"""A service that can be made busy for ever, or asleep for ever, by a request."""

import os
import time
from typing import Any

from pydantic import Field
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from handover.serving.server import run
from handover.settings import RESTARTED, Settings


class BusySettings(Settings):
    busy_port: int = Field(9200, description="REST port")


async def answer(_: Request) -> Response:
    return PlainTextResponse("ok")


async def restarted(_: Request) -> Response:
    return PlainTextResponse(os.environ.get(RESTARTED, "no"))


async def spin(_: Request) -> Response:
    while True:
        pass


async def sleep(_: Request) -> Response:
    while True:
        time.sleep(60)


def make_app(_: BusySettings) -> Any:
    paths = {"/healthz": answer, "/readyz": answer, "/restarted": restarted, "/spin": spin, "/sleep": sleep}
    return Starlette(routes=[Route(path, endpoint) for path, endpoint in paths.items()])


if __name__ == "__main__":
    run("busy", make_app, BusySettings, port_field="busy_port")
