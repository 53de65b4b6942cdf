"""Ports: taken ones are named, leaving ones waited for, held ones kept."""

import asyncio
import contextlib
import socket
import struct
from collections.abc import Iterator

import pytest

from handover.errors import UsageError
from handover.ports import PortLeaving, held, hold, require_free

HERE = "127.0.0.1"
SETTING = "HANDOVER_LAMP_PORT"


@pytest.fixture
def connection() -> Iterator[socket.socket]:
    """A connection to a server of nobody's concern; what matters is the port on its own side."""
    with socket.create_server((HERE, 0)) as server:
        outgoing = socket.create_connection(server.getsockname())
        incoming, _ = server.accept()
        with outgoing, incoming:
            yield outgoing


def test_a_taken_port_is_named_with_the_way_out() -> None:
    with socket.create_server((HERE, 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UsageError, match=rf"port {port} .* taken .* {SETTING}"):
            require_free(HERE, port, SETTING, say=pytest.fail)
    require_free(HERE, port, SETTING, say=pytest.fail)


def test_an_address_of_another_machine_is_named() -> None:
    with pytest.raises(UsageError, match=r"192\.0\.2\.1 cannot be used \(.*\)"):
        require_free("192.0.2.1", 54210, SETTING, say=pytest.fail)


async def test_a_port_that_a_leaving_connection_holds_is_waited_for(connection: socket.socket) -> None:
    port = connection.getsockname()[1]
    with pytest.raises(PortLeaving, match=rf"port {port} .* connection"):
        hold(HERE, port, SETTING)
    told: list[str] = []
    waiting = asyncio.create_task(held(HERE, port, SETTING, say=told.append))
    async with asyncio.timeout(10):
        while not told:
            await asyncio.sleep(0)
    assert f"port {port}" in told[0]
    # A reset instead of a goodbye, so that the system forgets the connection at once.
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()
    (await asyncio.wait_for(waiting, 10)).close()
    assert len(told) == 1


def test_a_server_can_listen_on_a_held_port_and_no_connection_gets_it() -> None:
    with socket.create_server((HERE, 0)) as server:
        port = server.getsockname()[1]
    with hold(HERE, port, SETTING):
        with socket.socket() as greedy, contextlib.suppress(OSError):
            greedy.bind((HERE, port))
            pytest.fail("the port was given away")
        with socket.create_server((HERE, port)), pytest.raises(UsageError, match="taken"):
            hold(HERE, port, SETTING)
