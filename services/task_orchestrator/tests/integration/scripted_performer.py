"""A performer that does what a script says and writes down what it did: a process of its own, that can die.

It keeps each result in a file before it reports it, as a robot knows what it holds: performed again after a
crash, the same Task gives the same result and is not done twice. A Task with `moves_s` is an act that must
not be repeated: if the performer is killed during it, the outcome is unknown, and the Task fails.
"""

import asyncio
import os
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import orjson
from fastapi import FastAPI

from handover.broker import BrokerClient
from handover.performer import Job, Performer, TaskFailed
from handover.serving.server import serve
from handover.serving.service import create_app
from handover.settings import Settings

PORT = int(os.environ["PERFORMER_PORT"])
DONE = Path(os.environ["PERFORMER_DONE"])
BEGUN = DONE.with_suffix(".begun")
"""The motions that were begun."""
SCRIPT = Path(os.environ["PERFORMER_SCRIPT"])


class Scripted(Performer):
    """Does each Task after a moment, with the outputs that the script names for `element-visit`."""

    async def may_repeat(self, job: Job) -> bool:
        return True

    async def perform(self, job: Job) -> Mapping[str, Any]:
        name = "-".join(job.task.id.rsplit("-", 2)[1:])
        script = orjson.loads(SCRIPT.read_bytes()).get(name, {})
        with suppress(TimeoutError):
            async with asyncio.timeout(script.pop("after_s", 0.01)):
                await job.changed()
        await job.checkpoint()
        done = _lines(DONE)
        moves_s = script.pop("moves_s", None)

        async def move() -> Mapping[str, Any]:
            _append(BEGUN, job.task.id)
            await asyncio.sleep(moves_s)
            _append(DONE, job.task.id)
            return {}

        if moves_s is not None:
            await job.once("the motion", move)
        elif not (job.resumed and job.task.id in done):
            _append(DONE, job.task.id)
        if "fails" in script:
            raise TaskFailed(script.pop("fails"), **script)
        return script


def _lines(file: Path) -> list[str]:
    return file.read_text().split() if file.exists() else []


def _append(file: Path, line: str) -> None:
    with file.open("a") as out:
        out.write(f"{line}\n")
        out.flush()


def make_app(settings: Settings) -> FastAPI:
    broker = BrokerClient(settings)
    performer = Scripted("scripted", settings, broker, notify_url=f"http://127.0.0.1:{PORT}/notifications")

    @asynccontextmanager
    async def on_duty(_: FastAPI) -> AsyncIterator[None]:
        await performer.act_for("urn:ngsi-ld:Device:demo:glove-1")
        await performer.act_for("urn:ngsi-ld:Device:demo:ur10-1")
        async with broker, performer:
            yield

    app = create_app("Scripted performer", description="for tests", lifespan=on_duty)
    performer.mount(app)
    return app


if __name__ == "__main__":
    loaded = Settings.load()
    serve(lambda: make_app(loaded), loaded, service="scripted", port=PORT, port_setting="PERFORMER_PORT")
