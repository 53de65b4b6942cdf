"""The outbound policy: allowed addresses, and the limit for inflated bodies."""

import asyncio
import gzip
import socket
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import pytest

from handover.errors import Problem, UsageError
from handover.network.http_client import (
    BodyReadingHttpClient,
    PooledHttpClient,
    ResponseTooLarge,
    SendError,
    inflate,
)
from handover.network.outbound_policy import (
    SETTING,
    AddressRefused,
    OutboundPolicy,
    is_loopback,
)
from handover.settings import PUBLIC_KEYS_FILE
from handover_broker.network.endpoints import require_allowed
from handover_broker.settings import BrokerSettings

ON_LOOPBACK, BEYOND = OutboundPolicy(), OutboundPolicy(listens_beyond_loopback=True)
NEVER = [
    "169.254.169.254", "169.254.0.1", "fe80::1", "fe80::1%eth0", "::ffff:169.254.169.254",
    "100.100.100.200", "168.63.129.16", "192.0.0.192", "fd00:ec2::254", "fd20:ce::254",
    "64:ff9b::a9fe:a9fe", "2002:a9fe:a9fe::1", "::169.254.169.254",
    "224.0.0.1", "239.255.255.250", "ff02::1",
]  # fmt: skip
LOOPBACK = ["127.0.0.1", "127.8.8.8", "::1", "0.0.0.0", "0.1.2.3", "::", "::ffff:127.0.0.1"]
NOT_PUBLIC = [
    "10.0.0.5", "172.16.0.1", "172.31.255.255", "192.168.1.4", "100.64.0.1", "100.127.255.254", "198.18.0.1",
    "192.0.0.8", "fd00::1", "fc00::1", "fec0::1", "::ffff:10.0.0.5", "64:ff9b::7f00:1", "64:ff9b::808:808",
    "64:ff9b:1::a00:5", "2002:7f00:1::1", "2001:0:4136:e378:8000:63bf:3fff:fdd2", "::127.0.0.1",
    "::ffff:0:7f00:1", "255.255.255.255", "240.0.0.1", "203.0.113.7", "2001:db8::1", "100::1", "4000::1",
]  # fmt: skip
PUBLIC = ["8.8.8.8", "172.32.0.1", "100.128.0.1", "::ffff:8.8.8.8", "2606:4700::1111", "2a00:1450:4001::1"]


@pytest.mark.parametrize("host", NEVER)
@pytest.mark.parametrize("policy", [ON_LOOPBACK, BEYOND], ids=["on loopback", "beyond"])
def test_link_local_metadata_and_multicast_addresses_are_always_refused(
    policy: OutboundPolicy, host: str
) -> None:
    assert SETTING in (policy.fault_of(host) or "")


@pytest.mark.parametrize("host", [*LOOPBACK, *NOT_PUBLIC])
def test_a_reachable_broker_connects_to_public_addresses_only(host: str) -> None:
    assert SETTING in (BEYOND.fault_of(host) or "")
    assert ON_LOOPBACK.fault_of(host) is None


@pytest.mark.parametrize("host", PUBLIC)
def test_public_addresses_are_allowed(host: str) -> None:
    assert BEYOND.fault_of(host) is None


@pytest.mark.parametrize(
    ("allowed", "opened", "refused"),
    [
        ("10.0.0.0/8", ["10.0.0.5", "::ffff:10.9.9.9"], ["192.168.1.4", "127.0.0.1", "64:ff9b::a00:5"]),
        ("127.0.0.1", ["127.0.0.1"], ["127.0.0.2", "::1"]),
        (" ::1 , fd00::/8,", ["::1", "fd12::5"], ["127.0.0.1", "fe80::1"]),
        ("169.254.169.254/32", ["169.254.169.254"], ["169.254.169.253"]),
        ("64:ff9b::/96", ["64:ff9b::808:808"], ["64:ff9b:1::808:808"]),
    ],
)
def test_the_setting_allows_networks_and_addresses(
    allowed: str, opened: list[str], refused: list[str]
) -> None:
    policy = BrokerSettings.load(host="0.0.0.0", outbound_allow=allowed).outbound_policy()
    assert [policy.fault_of(one) for one in opened] == [None] * len(opened)
    assert all(policy.fault_of(one) for one in refused)


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST"])
def test_the_setting_allows_hosts_by_name(host: str) -> None:
    policy = OutboundPolicy.of("0.0.0.0", "task-orchestrator,localhost")
    assert set(asyncio.run(policy.resolved(host, 80))) <= {"127.0.0.1", "::1"}
    assert policy.fault_of("127.0.0.1"), "the name is open, not every way to write its address"


@pytest.mark.parametrize("wrong", ["10.0.0.1/8", "10.0.0.300", "http://cell:80", "a b", "*", "10.0.0.0/33"])
def test_an_invalid_entry_is_named_in_the_error(wrong: str) -> None:
    with pytest.raises(UsageError, match=SETTING) as refused:
        BrokerSettings.load(outbound_allow=f"localhost,{wrong}")
    assert repr(wrong) in str(refused.value)


@pytest.mark.parametrize("host", ["localhost", "127.1", "2130706433", "0x7f.1", "0177.0.0.1"])
def test_names_and_odd_spellings_are_checked_by_their_address(host: str) -> None:
    with pytest.raises(AddressRefused, match="this machine"):
        asyncio.run(BEYOND.resolved(host, 80))
    with pytest.raises(Problem) as refused:
        asyncio.run(require_allowed(BEYOND, f"http://{host}/", "the endpoint"))
    assert refused.value.status == 400
    assert SETTING in refused.value.detail


def test_an_unresolved_name_is_accepted_and_fails_when_used() -> None:
    asyncio.run(require_allowed(BEYOND, "http://nobody.invalid/", "the endpoint"))
    with pytest.raises(SendError):
        asyncio.run(PooledHttpClient(BEYOND).post("http://nobody.invalid/", [], b"", 5))


@pytest.mark.parametrize("client", [PooledHttpClient, BodyReadingHttpClient])
def test_a_refused_address_is_refused_again_when_it_is_used(client: type[PooledHttpClient]) -> None:
    with pytest.raises(SendError, match=SETTING):
        asyncio.run(client(BEYOND).post("http://127.0.0.1:9/", [], b"", 5))


def test_a_connection_uses_the_checked_address() -> None:
    """A name server that returns an allowed address first and a refused one from then on."""

    async def scenario() -> tuple[int, int]:
        served = 0

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            nonlocal served
            served += 1
            await reader.readuntil(b"\r\n\r\n")
            writer.write(b"HTTP/1.1 204 No Content\r\nConnection: close\r\n\r\n")
            writer.close()

        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        loop, lookups = asyncio.get_running_loop(), 0
        genuine = loop.getaddrinfo

        async def rebinding(host: Any, *args: Any, **kwargs: Any) -> Any:
            nonlocal lookups
            if host != "rebound.example":
                return await genuine(host, *args, **kwargs)
            lookups += 1
            first = "127.0.0.1" if lookups == 1 else "127.0.0.99"
            return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (first, port))]

        loop.getaddrinfo = rebinding  # type: ignore[method-assign]  # stands for the name server
        policy = OutboundPolicy.of("0.0.0.0", "127.0.0.1")
        assert await PooledHttpClient(policy).post(f"http://rebound.example:{port}/", [], b"", 5) == 204
        with pytest.raises(SendError, match=SETTING):
            await PooledHttpClient(policy).post(f"http://rebound.example:{port}/", [], b"", 5)
        server.close()
        return served, lookups

    assert asyncio.run(scenario()) == (1, 2), "one look-up for each connection, and none behind it"


@pytest.mark.parametrize(
    ("host", "beyond"),
    [
        ("127.0.0.1", False),
        ("localhost", False),
        ("::1", False),
        ("::1%lo", False),
        ("::ffff:127.0.0.1", False),
        ("::ffff:10.0.0.1", True),
        ("0.0.0.0", True),
        ("::", True),
        ("192.168.1.4", True),
        ("my-host", True),
    ],
)
def test_the_address_that_the_broker_listens_on_decides(host: str, *, beyond: bool) -> None:
    assert BrokerSettings.load(host=host).outbound_policy().listens_beyond_loopback is beyond
    assert is_loopback(host) is not beyond


def test_with_accounts_only_our_own_services_are_reached_on_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HANDOVER_ORCHESTRATOR_PORT", "15200")
    policy = BrokerSettings.load(
        data_dir=tmp_path, outbound_allow="127.0.0.1:1883,[::1]:1884,mes:80"
    ).outbound_policy()
    others = ("127.0.0.1", "::1", "127.8.8.8", "::ffff:127.0.0.1", "64:ff9b::7f00:1")
    assert [policy.fault_of(one, 9) for one in others] == [None] * len(others), "local mode"
    (tmp_path / "security").mkdir()
    (tmp_path / "security" / PUBLIC_KEYS_FILE).touch()
    assert all(SETTING in (policy.fault_of(one, 9) or "") for one in others)
    for port in (54200, 54400, 15200, 1883):
        assert policy.fault_of("127.0.0.1", port) is None
    assert policy.fault_of("::1", 1884) is None
    assert policy.fault_of("192.168.7.4", 9) is None
    assert ("mes", 80) in policy.endpoints
    with pytest.raises(AddressRefused, match="with accounts"):
        asyncio.run(policy.resolved("localhost", 9))
    assert asyncio.run(policy.resolved("localhost", 54200))


@pytest.mark.nightly
@pytest.mark.parametrize("pack", [gzip.compress, zlib.compress])
def test_a_body_is_inflated_up_to_the_limit(pack: Any) -> None:
    assert inflate(pack(b"x" * 1000), 1000) == b"x" * 1000
    with pytest.raises(ResponseTooLarge, match="inflates to more than 999 bytes"):
        inflate(pack(b"x" * 1000), 999)
    with pytest.raises(SendError, match="cut"):
        inflate(pack(bytes(range(256)) * 9)[:-9], 10_000)
    bomb = pack(bytes(200 * 1024 * 1024))
    tracemalloc.start()
    with pytest.raises(ResponseTooLarge):
        inflate(bomb, 1024 * 1024)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 * 1024 * 1024


def test_an_invalid_compressed_body_is_an_error() -> None:
    with pytest.raises(SendError, match="cannot be inflated"):
        inflate(b"no gzip at all", 1000)
