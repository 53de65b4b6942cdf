"""Vendors' services against a real HTTP server with a token endpoint: tokens, renewals, refusals, policy."""

import asyncio
import base64
import json
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from handover.network.outbound_policy import OutboundPolicy
from handover_body.drivers.base import PacketError
from handover_body.drivers.cloud.driver import CloudSettings
from handover_body.drivers.runner import RunnerTiming, SensorRunner
from handover_body.drivers.vivalink.driver import VivalinkDriver
from handover_body.model.signals import LinkState, Samples, SensorReport, SignalKind
from tests.kit.waiting import until


class Vendor:
    """An HTTP/1.1 server with `/token` (RFC 6749) and the data of one device."""

    def __init__(self) -> None:
        self.tokens: set[str] = set()
        self.granted: list[dict[str, list[str]]] = []
        self.rows: Any = []
        self.paths: list[str] = []
        self.lifetime_s = 3600
        self.refuses = False
        self.port = 0

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                head = (await reader.readuntil(b"\r\n\r\n")).decode()
                method, target, _ = head.split("\r\n", 1)[0].split(" ")
                lines = [line.partition(": ")[::2] for line in head.split("\r\n")[1:] if line]
                headers = {name.lower(): value for name, value in lines}
                body = await reader.readexactly(int(headers.get("content-length", "0")))
                status, content = self.answer(method, target, headers, body.decode())
                data = json.dumps(content).encode()
                writer.write(f"HTTP/1.1 {status} X\r\nContent-Length: {len(data)}\r\n\r\n".encode() + data)
                await writer.drain()
        writer.close()

    def answer(self, method: str, target: str, headers: dict[str, str], body: str) -> tuple[int, Any]:
        if method == "POST" and target == "/token":
            secret = base64.b64encode(b"us:se%26cret").decode()
            if self.refuses or headers.get("authorization") != f"Basic {secret}":
                return 401, {"error": "invalid_client"}
            self.granted.append(parse_qs(body))
            token = f"token-{len(self.granted)}"
            self.tokens.add(token)
            return 200, {"access_token": token, "token_type": "Bearer", "expires_in": self.lifetime_s}
        if headers.get("authorization", "").removeprefix("Bearer ") not in self.tokens:
            return 401, {"error": "invalid_token"}
        self.paths.append(target)
        return 200, {"data": self.rows}


@pytest.fixture
async def vendor() -> AsyncIterator[Vendor]:
    one = Vendor()
    server = await asyncio.start_server(one.serve, "127.0.0.1", 0)
    one.port = server.sockets[0].getsockname()[1]
    yield one
    server.close()


@asynccontextmanager
async def polling(
    vendor: Vendor, policy: OutboundPolicy | None = None, **settings: Any
) -> AsyncIterator[tuple[SensorRunner, list[Samples | SensorReport]]]:
    url = f"http://127.0.0.1:{vendor.port}"
    given = {
        "base_url": url, "token_url": f"{url}/token", "client_id": "us", "client_secret": "se&cret",
        "device_id": "patch/1", "poll_s": 0.02, **settings,
    }  # fmt: skip
    driver = VivalinkDriver("patch", CloudSettings.model_validate(given), policy)
    items: list[Samples | SensorReport] = []
    runner = SensorRunner(driver, items.append, timing=RunnerTiming(0.01, 0.02, 0.01))
    task = asyncio.create_task(runner.run())
    try:
        yield runner, items
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


def rates(items: list[Samples | SensorReport]) -> list[float]:
    return [
        float(value)
        for one in items
        if isinstance(one, Samples) and one.info.kind is SignalKind.HEART_RATE
        for value in one.values[:, 0]
    ]


def texts(items: list[Samples | SensorReport]) -> str:
    return " | ".join(one.text for one in items if isinstance(one, SensorReport))


async def test_values_are_polled_once_each_with_a_token(vendor: Vendor) -> None:
    now_ms = time.time() * 1000
    vendor.rows = [{"time": now_ms - 2000, "hr": 70, "rr": 14}, {"time": now_ms - 1000, "hr": 71, "rr": -1}]
    async with polling(vendor) as (runner, items):
        await until(lambda: len(rates(items)) == 2)
        vendor.rows = [*vendor.rows, {"time": now_ms, "hr": 72, "leadOn": False}]
        await until(lambda: len(rates(items)) == 3)
        polls = len(vendor.paths)
        await until(lambda: len(vendor.paths) > polls + 2)
        assert rates(items) == [70, 71, 72]
        last = [one for one in items if isinstance(one, Samples)][-1]
        assert last.quality == 0.0
        assert runner.link is LinkState.CONNECTED
    assert vendor.granted == [{"grant_type": ["client_credentials"]}]
    assert urlsplit(vendor.paths[0]).path == "/devices/patch%2F1/vitals"


async def test_a_token_that_was_revoked_is_renewed(vendor: Vendor) -> None:
    async with polling(vendor, refresh_token="given", scope="vitals") as (_, items):
        await until(lambda: vendor.paths)
        vendor.tokens.clear()
        vendor.rows = [{"time": time.time() * 1000, "hr": 66}]
        await until(lambda: rates(items) == [66])
    assert len(vendor.granted) == 2
    assert vendor.granted[0] == {
        "grant_type": ["refresh_token"], "refresh_token": ["given"], "scope": ["vitals"]
    }  # fmt: skip


async def test_refused_credentials_are_reported_and_retried(vendor: Vendor) -> None:
    vendor.refuses = True
    async with polling(vendor) as (runner, items):
        await until(lambda: "refuses the credentials" in texts(items))
        vendor.refuses = False
        await until(lambda: runner.link is LinkState.CONNECTED)
        assert "se&cret" not in texts(items)


async def test_an_address_that_the_policy_refuses_is_not_reached(vendor: Vendor) -> None:
    async with polling(vendor, OutboundPolicy.of("0.0.0.0", "")) as (_, items):
        await until(lambda: "HANDOVER_OUTBOUND_ALLOW" in texts(items))
    assert vendor.granted == []


async def test_an_answer_that_is_not_as_documented_is_dropped(vendor: Vendor) -> None:
    vendor.rows = "rubbish"
    async with polling(vendor) as (runner, items):
        await until(lambda: "no list" in texts(items))
        assert runner.link is LinkState.CONNECTED


def test_an_address_without_encryption_is_refused() -> None:
    with pytest.raises(ValidationError, match="not encrypted"):
        CloudSettings(
            base_url="http://vendor.example", token_url="https://vendor.example/token",
            client_id="us", client_secret="x", device_id="1",
        )  # fmt: skip


anything = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["data", "time", "hr", "rr", "leadOn"]), inner)
    ),
)


@given(content=anything)
def test_any_answer_is_read_or_refused(content: Any) -> None:
    settings = CloudSettings(
        base_url="https://v.example", token_url="https://v.example/t", client_id="a",
        client_secret="b", device_id="c",
    )  # fmt: skip
    try:
        values = VivalinkDriver("patch", settings)._checked(content)
    except PacketError:
        return
    assert all(one.value > 0 for one in values)
