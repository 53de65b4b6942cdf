"""Services over an installed ROS, with any middleware."""

import asyncio
import concurrent.futures
from collections.abc import Callable
from typing import Any

import structlog

from handover_ros.errors import BadMessage, ClosedUnanswered, OutcomeUnknown, ServerLost, ServiceUnavailable
from handover_ros.graph.goals import too_busy, unanswered
from handover_ros.graph.port import Message, ServiceHandler
from handover_ros.graph.qos import MAX_REQUESTS_IN_FLIGHT
from handover_ros.graph.ros_installed.own_node import DISCOVERY_DELAY_S, OwnRosNode, as_future, interface
from handover_ros.graph.waiting import until

log = structlog.get_logger(__name__)

_SERVER_LOST_AFTER_S = 2.0


class RosClient:
    """Calls one service."""

    def __init__(self, node: OwnRosNode, service: str, type_name: str) -> None:
        self.service = service
        self.type_name = type_name
        self._node = node
        self._interface = interface(type_name, node.store)
        self._client = node.node.create_client(self._interface, service, callback_group=node.group)
        self._waiting: set[asyncio.Future[Any]] = set()
        self._settled = False
        self._free = asyncio.Semaphore(MAX_REQUESTS_IN_FLIGHT)

    async def call(self, request: Message, timeout_s: float) -> Message:
        """Send the request and return the response.

        Raises:
            BadMessage, ServiceUnavailable: nothing was sent.
            CallTimeout, ServerLost, OutcomeUnknown, ClosedUnanswered: it was sent, and not answered.
        """
        start_s = asyncio.get_running_loop().time()
        asked = self._node.to_ros(self._interface.Request, f"{self.type_name}_Request", request)
        if not await until(self._client.service_is_ready, timeout_s):
            raise ServiceUnavailable(
                f"no node serves {self.service} ({self.type_name}); start its node, or check the name and "
                "the number of the domain (ROS_DOMAIN_ID)"
            )
        is_sent = False
        try:
            async with asyncio.timeout_at(start_s + timeout_s), self._free:
                if not self._settled:
                    await asyncio.sleep(min(DISCOVERY_DELAY_S, timeout_s / 2))
                    self._settled = True
                is_sent = True
                response = await self._answer(asked)
        except TimeoutError:
            if is_sent:
                raise unanswered(self.service, timeout_s) from None
            raise too_busy(self.service) from None
        try:
            return self._node.from_ros(f"{self.type_name}_Response", response)
        except BadMessage as error:
            raise OutcomeUnknown(
                f"{self.service} answered, and its answer cannot be read: {error}"
            ) from error

    def _servers(self) -> frozenset[bytes]:
        """Return the present servers, by the ids of their publishers of responses."""
        publishers = self._node.node.get_publishers_info_by_topic(f"rr{self.service}Reply", no_mangle=True)
        return frozenset(bytes(publisher.endpoint_gid) for publisher in publishers)

    async def _answer(self, asked: Any) -> Any:
        servers = self._servers()
        pending = self._client.call_async(asked)
        answer = as_future(pending, asyncio.get_running_loop())
        self._waiting.add(answer)
        try:
            while True:
                done, _ = await asyncio.wait([answer], timeout=_SERVER_LOST_AFTER_S)
                if done:
                    return answer.result()
                if servers and not await until(lambda: bool(servers & self._servers()), _SERVER_LOST_AFTER_S):
                    raise ServerLost(f"the server of {self.service} went away before it answered")
        finally:
            self._client.remove_pending_request(pending)
            self._waiting.discard(answer)

    def close(self) -> None:
        """Close the client; pending calls end with `ClosedUnanswered`."""
        for waiting in self._waiting:
            if not waiting.done():
                waiting.set_exception(ClosedUnanswered(f"{self.service} was closed before it answered"))
        self._node.node.destroy_client(self._client)


class RosServer:
    """Serves one service; see `port.Served`."""

    def __init__(
        self,
        node: OwnRosNode,
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
        self._node = node
        self._handler = handler
        self._closed = closed
        self._loop = asyncio.get_running_loop()
        self._working: set[concurrent.futures.Future[Message]] = set()
        self._open = True
        self._interface = interface(type_name, node.store)
        self._service = node.node.create_service(
            self._interface, service, self._asked, callback_group=node.group
        )
        self._send = self._service.send_response
        # rclpy sends whatever a callback returns; None is the result of a failed handler.
        self._service.send_response = self._send_if_answered

    def _send_if_answered(self, response: Any, header: Any) -> None:
        if response is not None:
            self._send(response, header)

    def _asked(self, request: Any, _: Any) -> Any:
        """Answer one request; in a thread of the executor, which waits for the loop."""
        self.calls += 1
        work = None
        try:
            asked = self._node.from_ros(f"{self.type_name}_Request", request)
            work = asyncio.run_coroutine_threadsafe(self._handle(asked), self._loop)
            self._working.add(work)
            return self._node.to_ros(self._interface.Response, f"{self.type_name}_Response", work.result())
        except concurrent.futures.CancelledError:
            return None
        except Exception as error:  # one request must not end the service
            self.failed += 1
            self.last_error = f"{type(error).__name__}: {error}"
            log.exception("answering a request failed", service=self.name)
            return None
        finally:
            if work is not None:
                self._working.discard(work)

    async def _handle(self, request: Message) -> Message:
        return await self._handler(request)

    async def close(self) -> None:
        if self._open:
            self._open = False
            for work in list(self._working):
                work.cancel()
            self._node.node.destroy_service(self._service)
            self._closed(self)
