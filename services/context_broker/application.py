"""The broker as an application: NGSI-LD under /ngsi-ld/v1 in plain ASGI, health and metrics beside it."""

import asyncio
from collections.abc import Mapping
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING

from starlette.types import ASGIApp, Receive, Scope, Send

from handover.errors import Problem
from handover.telemetry import get_logger
from services.context_broker.api.exchange import (
    PREFIX,
    Answer,
    Disconnected,
    Request,
    of_tenant,
    problem_answer,
    send_answer,
)
from services.context_broker.api.http_protocol import BrokerProtocol
from services.context_broker.api.problems import went_wrong

if TYPE_CHECKING:
    from handover.service import Check
    from services.context_broker.app import Broker

log = get_logger(__name__)


class BrokerApplication:
    """The broker as an ASGI application; its server may also take the short way in, by `protocol`."""

    def __init__(self, broker: "Broker", checks: "Mapping[str, Check]") -> None:
        self._broker = broker
        self._checks = checks
        self._rest: ASGIApp | None = None
        self.protocol = partial(BrokerProtocol, door=self.answer)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that came in over ASGI, or live from start to stop."""
        if scope["type"] == "lifespan":
            await self._live(receive, send)
        elif scope["type"] != "http" or not scope["path"].startswith(PREFIX):
            await (await self._others())(scope, receive, send)
        elif (answer := await self.answer(Request.of_scope(scope), receive)) is not None:
            await send_answer(send, answer)

    async def _live(self, receive: Receive, send: Send) -> None:
        await receive()
        try:
            await self._broker.start()
        except BaseException as error:
            await asyncio.to_thread(self._broker.journal.close)
            await send({"type": "lifespan.startup.failed", "message": str(error)})
            raise
        await send({"type": "lifespan.startup.complete"})
        await receive()
        await self._broker.stop()
        await send({"type": "lifespan.shutdown.complete"})

    async def _others(self) -> ASGIApp:
        """Return what answers to all but NGSI-LD: health, metrics and their like."""
        if self._rest is None:
            # The web framework takes a quarter of the start; who asks about NGSI-LD does not wait for it.
            service = await asyncio.to_thread(import_module, "handover.service")
            self._rest = service.create_app(
                "Context broker",
                description="An NGSI-LD broker (ETSI GS CIM 009). NGSI-LD itself is under /ngsi-ld/v1.",
                checks=self._checks,
            )
        return self._rest

    async def answer(self, request: Request, body: bytes | Receive) -> Answer | None:
        """Return the answer to a request about NGSI-LD; None if the asker has gone."""
        try:
            return await self._broker.answer(request, body)
        except Problem as problem:
            return of_tenant(request, problem_answer(problem))
        except Disconnected:
            return None
        except Exception as error:  # one broken request must not end the connection without an answer
            log.exception("request failed", method=request.method, path=request.path)
            return of_tenant(request, problem_answer(went_wrong(error, "answering")))
