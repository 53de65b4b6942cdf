"""Ports: taken ones are named, leaving ones waited for, held ones kept."""

import asyncio
import contextlib
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from handover.errors import UsageError
from handover.runtime import ports
from handover.runtime.ports import PortLeaving, held, hold, hold_when_free, require_free, unreserved
from tests.kit.skipping import NO_IPV6

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


def reset(connection: socket.socket) -> None:
    """End a connection by a reset, so that the system forgets it at once."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


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
    reported: list[str] = []
    waiting = asyncio.create_task(held(HERE, port, SETTING, say=reported.append))
    async with asyncio.timeout(120):
        while not reported:
            await asyncio.sleep(0)
    assert f"port {port}" in reported[0]
    assert "is held by a connection to " in reported[0]  # maybe another one, with the same local port
    reset(connection)
    (await asyncio.wait_for(waiting, 120)).close()
    assert len(reported) == 1


def test_a_server_can_listen_on_a_held_port_and_no_connection_gets_it() -> None:
    with socket.create_server((HERE, 0)) as server:
        port = server.getsockname()[1]
    with hold(HERE, port, SETTING):
        with socket.socket() as greedy, contextlib.suppress(OSError):
            greedy.bind((HERE, port))
            pytest.fail("the port was given away")
        with socket.create_server((HERE, port)), pytest.raises(UsageError, match="taken"):
            hold(HERE, port, SETTING)


def test_a_connection_that_lasts_is_waited_for_as_long_as_it_does(
    connection: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0
    waits: list[float] = []

    def sleep(seconds: float) -> None:
        nonlocal now_s
        now_s += seconds
        waits.append(seconds)
        if now_s > 300 and connection.fileno() >= 0:
            reset(connection)

    monkeypatch.setattr(ports, "time", SimpleNamespace(monotonic=lambda: now_s, sleep=sleep))
    reported: list[str] = []
    hold_when_free(HERE, connection.getsockname()[1], SETTING, say=reported.append).close()
    assert now_s > 300
    assert max(waits) == ports.MAX_DELAY_S
    assert 5 <= len(reported) <= now_s / ports.SAY_AGAIN_S + 1, "once a minute"


def test_a_program_that_listens_on_another_of_our_addresses_is_not_waited_for() -> None:
    with hold(HERE, 0, SETTING) as unused:  # so that no other program listens at the first address
        port = unused.getsockname()[1]
        with (
            socket.create_server(("127.0.0.2", port)),
            pytest.raises(UsageError, match=rf"port {port} .* taken"),
        ):
            hold_when_free("0.0.0.0", port, SETTING, say=pytest.fail)
        hold_when_free(HERE, port, SETTING, say=pytest.fail).close()


def test_a_port_of_ipv6_names_its_holder_too() -> None:
    try:
        listening = socket.create_server(("::1", 0), family=socket.AF_INET6)
    except OSError:
        pytest.skip(NO_IPV6)
    with (
        listening as server,
        socket.create_connection(server.getsockname()[:2]) as outgoing,
        pytest.raises(PortLeaving, match=rf"connection .* to ::1:{server.getsockname()[1]}"),
    ):
        hold("::1", outgoing.getsockname()[1], SETTING)


async def test_a_program_that_listens_on_ipv4_alone_does_not_keep_a_server_from_ipv6() -> None:
    if not socket.has_dualstack_ipv6():
        pytest.skip("there is no IPv6 here")
    with socket.create_server((HERE, 0)) as other:
        port = other.getsockname()[1]
        with hold_when_free("::", port, SETTING, say=pytest.fail):
            server = await asyncio.get_running_loop().create_server(asyncio.Protocol, "::", port)
            server.close()
            await server.wait_closed()


def test_what_is_not_reserved_in_the_range_of_outgoing_connections_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ports, "_SYSCTL", tmp_path)
    assert unreserved([54200]) == [], "another system"
    (tmp_path / "ip_local_port_range").write_text("32768\t60999\n")
    (tmp_path / "ip_local_reserved_ports").write_text("\n")
    assert unreserved([1026, 54200, 54000]) == [54000, 54200]
    (tmp_path / "ip_local_reserved_ports").write_text("54000,54100-54300\n")
    assert unreserved([1026, 54400, 54200, 54000]) == [54400]
