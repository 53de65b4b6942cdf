"""Publishing notifications over MQTT: one connection for each server and identity, kept open (clause 7.2)."""

import asyncio
import socket
import ssl
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Self

from handover.network.http_client import ResponseTimeout, SendError
from handover.network.outbound_policy import AddressRefused, OutboundPolicy
from handover_broker.delivery.mqtt_address import MqttAddress

GOODBYE_WITHIN_S: Final = 1.0
"""How long a disconnect may take."""


class _NamedTls(ssl.SSLContext):
    """TLS to a server whose certificate is checked by `name`, while the connection is made to an address.

    The MQTT library knows one host only. Given the name it would resolve it itself, without the outbound
    policy.
    """

    name: str

    def __new__(cls, *_: Any) -> Self:
        return super().__new__(cls, ssl.PROTOCOL_TLS_CLIENT)

    def __init__(self, name: str, ca_files: Sequence[Path]) -> None:
        self.name = name
        self.load_default_certs()
        for file in ca_files:
            self.load_verify_locations(file)

    def wrap_socket(self, sock: socket.socket, *args: Any, **kwargs: Any) -> ssl.SSLSocket:
        return super().wrap_socket(sock, *args, **{**kwargs, "server_hostname": self.name})


class _Connection:
    """A connection to one server; opened when there is something to publish, and again after a failure."""

    def __init__(self, where: MqttAddress, sender: "MqttSender") -> None:
        self._where = where
        self._sender = sender
        self._connecting: asyncio.Task[Any] | None = None
        self._farewells: set[asyncio.Task[None]] = set()

    async def publish(self, topic: str, qos: int, payload: bytes, timeout_s: float) -> None:
        """Publish; with a `qos` above 0 return once the server has acknowledged. Raises `SendError`."""
        was_there = self._connecting is not None and self._connecting.done()
        try:
            async with asyncio.timeout(timeout_s):
                try:
                    await self._publish(topic, qos, payload, timeout_s)
                except SendError:
                    if not was_there:
                        raise
                    # The server may have closed it while it was idle: try once more on a new one.
                    await self._publish(topic, qos, payload, timeout_s)
        except TimeoutError:
            self._drop(self._connecting if was_there else None)
            raise ResponseTimeout(f"no answer within {timeout_s:g} s") from None

    async def _publish(self, topic: str, qos: int, payload: bytes, timeout_s: float) -> None:
        from aiomqtt import MqttError  # noqa: PLC0415 - takes time to load, and few subscribers want it

        if self._connecting is None:
            self._connecting = asyncio.get_running_loop().create_task(self._connect())
        connecting = self._connecting
        try:
            # A connection that takes longer than this attempt is ready for the next one.
            client = await asyncio.shield(connecting)
            await client.publish(topic, payload, qos=qos, timeout=timeout_s)
        except AddressRefused as refused:
            self._drop(connecting)
            raise SendError(str(refused)) from None
        except (MqttError, OSError, ValueError) as error:
            self._drop(connecting)
            raise SendError(str(error) or type(error).__name__) from None

    async def close(self) -> None:
        """Disconnect."""
        self._drop(self._connecting)
        if self._farewells:
            await asyncio.wait(self._farewells, timeout=GOODBYE_WITHIN_S)

    async def _connect(self) -> Any:
        from aiomqtt import Client, MqttError, ProtocolVersion  # noqa: PLC0415 - see above

        where = self._where
        tls = await asyncio.to_thread(_NamedTls, where.host, self._sender.ca_files) if where.tls else None
        failure: MqttError | None = None
        for address in await self._sender.policy.resolved(where.host, where.port):
            client = Client(
                address,
                where.port,
                username=where.username,
                password=where.password,
                protocol=ProtocolVersion.V5 if where.version == "5.0" else ProtocolVersion.V311,
                tls_context=tls,
            )
            try:
                await client.__aenter__()
            except MqttError as error:
                failure = error
            else:
                return client
        raise failure or MqttError(f"{where.host} has no address")

    def _drop(self, connecting: "asyncio.Task[Any] | None") -> None:
        """Remove a connection that failed, unless there is a new one already."""
        if connecting is None or connecting is not self._connecting:
            return
        self._connecting = None
        farewell = asyncio.get_running_loop().create_task(_say_goodbye(connecting))
        self._farewells.add(farewell)
        farewell.add_done_callback(self._farewells.discard)


async def _say_goodbye(connecting: "asyncio.Task[Any]") -> None:
    with suppress(Exception):  # the result does not matter: the connection is closed
        client = await connecting
        await client.__aexit__(None, None, None)


class MqttSender:
    """Publishes to many servers. `ca_files` (PEM) name certificate authorities besides the system's."""

    def __init__(self, policy: OutboundPolicy, ca_files: Sequence[Path] = ()) -> None:
        self.policy = policy
        self.ca_files = ca_files
        self._connections: dict[tuple[Any, ...], _Connection] = {}

    async def publish(self, where: MqttAddress, payload: bytes, timeout_s: float) -> None:
        """Publish; raise `SendError` when the server does not acknowledge within `timeout_s`."""
        connection = self._connections.get(where.connection)
        if connection is None:
            connection = self._connections[where.connection] = _Connection(where, self)
        await connection.publish(where.topic, where.qos, payload, timeout_s)

    async def close(self) -> None:
        """Close all connections."""
        for connection in self._connections.values():
            await connection.close()
        self._connections.clear()
