"""Services over a rosbridge server."""

import asyncio
import re
from collections.abc import Callable
from typing import Any

import structlog

from handover_ros.errors import (
    BadMessage,
    CallTimeout,
    OutcomeUnknown,
    PublishBlocked,
    ServiceUnavailable,
)
from handover_ros.graph.goals import unanswered
from handover_ros.graph.port import Message, ServiceHandler
from handover_ros.graph.rosbridge.connection import Connection, Operation
from handover_ros.graph.rosbridge.json_codec import JsonCodec

log = structlog.get_logger(__name__)

_UNANSWERED = re.compile(r"time[d ]*out", re.IGNORECASE)


async def call(
    connection: Connection,
    codec: JsonCodec,
    service: str,
    type_name: str,
    request: Message,
    *,
    timeout_s: float,
) -> Message:
    """Call a service and return its response.

    Raises:
        BadMessage, PublishBlocked: nothing was sent.
        ServiceUnavailable: the server reports a failure, with its reason.
        CallTimeout, ServerLost, OutcomeUnknown: it was sent, and not answered.
    """
    args, _ = codec.to_json(f"{type_name}_Request", request)
    try:
        answer = await connection.request(
            timeout_s,
            op="call_service",
            id=connection.new_id(f"call_service:{service}"),
            service=service,
            type=codec.type_name(type_name),
            args=args,
        )
    except TimeoutError:
        raise unanswered(service, timeout_s) from None
    if answer.get("result") is False:
        reason = str(answer.get("values"))[:300]
        if _UNANSWERED.search(reason):  # the server has a time limit of its own
            raise CallTimeout(f"{service} was not answered; the rosbridge server reports: {reason}")
        raise ServiceUnavailable(
            f"{service} ({type_name}) was not answered; the rosbridge server reports: {reason}"
        )
    try:
        return codec.message(f"{type_name}_Response", answer.get("values") or {})
    except BadMessage as error:
        raise OutcomeUnknown(f"{service} answered, and its answer cannot be read: {error}") from error


class RosbridgeServer:
    """A served service; see `port.Served`. If the handler raises, the caller receives the reason."""

    def __init__(
        self,
        connection: Connection,
        codec: JsonCodec,
        service: str,
        type_name: str,
        handler: ServiceHandler,
        *,
        closed: Callable[[Any], None],
    ) -> None:
        self.name = service
        self.type_name = type_name
        self.calls = 0
        self.failed = 0
        self.last_error: str | None = None
        self._connection = connection
        self._codec = codec
        self._handler = handler
        self._closed = closed
        self._working: set[asyncio.Task[None]] = set()
        self._open = True
        connection.on("call_service", self._asked)
        connection.on_opening(self._advertise)
        self._advertise()

    def _advertise(self) -> None:
        self._connection.send(
            op="advertise_service", service=self.name, type=self._codec.type_name(self.type_name)
        )

    def _asked(self, operation: Operation) -> None:
        if operation.get("service") == self.name:
            self.calls += 1
            work = asyncio.create_task(self._answer(operation))
            self._working.add(work)
            work.add_done_callback(self._working.discard)

    async def _answer(self, operation: Operation) -> None:
        values: Any
        try:
            request = self._codec.message(f"{self.type_name}_Request", operation.get("args") or {})
            response = await self._handler(request)
            values, _ = self._codec.to_json(f"{self.type_name}_Response", response)
            done = True
        except Exception as error:  # one request must not end the service
            self.failed += 1
            self.last_error = f"{type(error).__name__}: {error}"
            log.exception("answering a request failed", service=self.name)
            values, done = self.last_error, False
        try:
            self._connection.send(
                op="service_response", id=operation.get("id"), service=self.name, values=values, result=done
            )
        except PublishBlocked as error:
            self.last_error = str(error)

    async def close(self) -> None:
        if self._open:
            self._open = False
            self._connection.off("call_service", self._asked)
            self._connection.off_opening(self._advertise)
            for work in list(self._working):
                work.cancel()
            if self._connection.is_open:
                self._connection.send(op="unadvertise_service", service=self.name)
            self._closed(self)
