"""The belt keeps the contract of sensor drivers, and any line is a number or refused."""

import asyncio
import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tcp_belt import BeltDriver, BeltSettings, parse

from handover_body.driver_contract import Device, SensorDriverContract
from handover_body.drivers.base import PacketError


@given(st.binary(max_size=40))
def test_any_line_is_a_finite_number_or_refused(line: bytes) -> None:
    with contextlib.suppress(PacketError):
        assert math.isfinite(parse(line))


class TestBelt(SensorDriverContract):
    @pytest.fixture
    async def device(self):
        writers: list[asyncio.StreamWriter] = []
        sent = [0]

        async def connected(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writers.append(writer)

        def write(data: bytes) -> None:
            for writer in writers:
                writer.write(data)

        def send() -> None:
            sent[0] += 1
            write(f"{math.sin(sent[0] / 5):.3f}\n".encode())

        def send_rubbish() -> None:
            write(b"\xff rubbish\n")

        def lose() -> None:
            while writers:
                writers.pop().close()

        server = await asyncio.start_server(connected, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        yield Device(
            BeltDriver("belt", BeltSettings(port=port)), send, lambda: write(b"\xff rubbish\n"), lose
        )
        lose()
        server.close()
