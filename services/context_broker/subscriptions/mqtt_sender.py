"""Publishing notifications over MQTT: one connection for each server and identity, kept open (clause 7.2)."""

import asyncio
import ssl
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from services.context_broker.subscriptions.destinations import Destinations, Refused
from services.context_broker.subscriptions.http_sender import SendError, TooSlow, trusting
from services.context_broker.subscriptions.mqtt_address import MqttAddress

GOODBYE_WITHIN_S: Final = 1.0
"""How long a server may take to hear that we leave."""


class _Connection:
    """A connection to one server; made when there is something to publish, and again when it broke."""

    def __init__(self, where: MqttAddress, sender: "MqttSender") -> None:
        self._where = where
        self._sender = sender
        self._connecting: asyncio.Task[Any] | None = None
        self._farewells: set[asyncio.Task[None]] = set()

    async def publish(self, topic: str, qos: int, payload: bytes, timeout_s: float) -> None:
        """Publish; with a `qos` above 0 return once the server has it. Raises `SendError`."""
        was_there = self._connecting is not None and self._connecting.done()
        try:
            async with asyncio.timeout(timeout_s):
                try:
                    await self._publish(topic, qos, payload, timeout_s)
                except SendError:
                    if not was_there:
                        raise
                    # The server may have closed it while nothing was sent: once more on a new one.
                    await self._publish(topic, qos, payload, timeout_s)
        except TimeoutError:
            self._drop(self._connecting if was_there else None)
            raise TooSlow(f"no answer within {timeout_s:g} s") from None

    async def _publish(self, topic: str, qos: int, payload: bytes, timeout_s: float) -> None:
        from aiomqtt import MqttError  # noqa: PLC0415 - takes time to load, and few subscribers want it

        if self._connecting is None:
            self._connecting = asyncio.get_running_loop().create_task(self._connect())
        connecting = self._connecting
        try:
            # A connection that takes longer than we wait is there for the next attempt.
            client = await asyncio.shield(connecting)
            await client.publish(topic, payload, qos=qos, timeout=timeout_s)
        except Refused as refused:
            self._drop(connecting)
            raise SendError(str(refused)) from None
        except (MqttError, OSError, ValueError) as error:
            self._drop(connecting)
            raise SendError(str(error) or type(error).__name__) from None

    async def close(self) -> None:
        """Say goodbye."""
        self._drop(self._connecting)
        if self._farewells:
            await asyncio.wait(self._farewells, timeout=GOODBYE_WITHIN_S)

    async def _connect(self) -> Any:
        from aiomqtt import Client, ProtocolVersion  # noqa: PLC0415 - see above

        where = self._where
        addresses = await self._sender.destinations.resolved(where.host, where.port)
        client = Client(
            where.host if where.tls else addresses[0],  # over TLS the name is checked by its certificate
            where.port,
            username=where.username,
            password=where.password,
            protocol=ProtocolVersion.V5 if where.version == "5.0" else ProtocolVersion.V311,
            tls_context=await self._sender.tls() if where.tls else None,
        )
        await client.__aenter__()
        return client

    def _drop(self, connecting: "asyncio.Task[Any] | None") -> None:
        """Forget a connection that failed, unless there is a new one already."""
        if connecting is None or connecting is not self._connecting:
            return
        self._connecting = None
        farewell = asyncio.get_running_loop().create_task(_say_goodbye(connecting))
        self._farewells.add(farewell)
        farewell.add_done_callback(self._farewells.discard)


async def _say_goodbye(connecting: "asyncio.Task[Any]") -> None:
    with suppress(Exception):  # it is of no use any more, however it ends
        client = await connecting
        await client.__aexit__(None, None, None)


class MqttSender:
    """Publishes to many servers. `ca_file` (PEM) names authorities trusted besides the system's."""

    def __init__(self, destinations: Destinations, ca_file: Path | None = None) -> None:
        self.destinations = destinations
        self._ca_file = ca_file
        self._tls: ssl.SSLContext | None = None
        self._connections: dict[tuple[Any, ...], _Connection] = {}

    async def publish(self, where: MqttAddress, payload: bytes, timeout_s: float) -> None:
        """Publish; raise `SendError` when the server does not take it within `timeout_s`."""
        connection = self._connections.get(where.connection)
        if connection is None:
            connection = self._connections[where.connection] = _Connection(where, self)
        await connection.publish(where.topic, where.qos, payload, timeout_s)

    async def tls(self) -> ssl.SSLContext:
        """Return how certificates are checked."""
        if self._tls is None:
            self._tls = await asyncio.to_thread(trusting, self._ca_file)
        return self._tls

    async def close(self) -> None:
        """Close all connections."""
        for connection in self._connections.values():
            await connection.close()
        self._connections.clear()
