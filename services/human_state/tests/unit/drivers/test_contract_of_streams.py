"""Drivers of a bracelet with a file, an LSL stream, a vendor and a ROS topic keep the contract, too."""

import asyncio
import os
import time
from collections.abc import AsyncIterator, Iterator
from typing import Any

import numpy as np
import pytest

from handover_body.driver_contract import Device, SensorDriverContract
from handover_body.drivers.cloud.driver import CloudSettings
from handover_body.drivers.corsano import protocol as corsano
from handover_body.drivers.corsano.driver import CorsanoDriver, CorsanoSettings
from handover_body.drivers.lsl.driver import LslDriver, LslSettings
from handover_body.drivers.ros_topic.driver import RosTopicDriver, RosTopicSettings
from handover_body.drivers.ros_topic.messages import type_of
from handover_body.drivers.vivalink.driver import VivalinkDriver
from handover_body.formats.ros import messages_of
from handover_body.model.signals import Samples, SignalInfo, SignalKind
from services.human_state.tests.unit.drivers.test_cloud import Vendor
from services.human_state.tests.unit.drivers.test_ros_topic import as_dds
from tests.kit.bluetooth import Peripheral
from tests.kit.ros_domains import ros_domain

ECG = SignalInfo(SignalKind.ECG, "D82", 130.0, ("I",))


class TestCorsano(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Device:
        one = Peripheral("CardioWatch", {corsano.SERVICE: (corsano.WRITE, corsano.FILE, corsano.ANSWER)})
        file = bytearray()

        def answer(_: str, data: bytes) -> None:
            if data[0] == corsano.GET_SIZE:
                body = bytes([corsano.GET_SIZE, 2]) + len(file).to_bytes(4, "little")
                one.notify(corsano.ANSWER, body + bytes([corsano.crc8(body)]))
                return
            size, offset = int.from_bytes(data[2:6], "little"), int.from_bytes(data[6:10], "little")
            for at in range(offset, offset + size, 20):
                one.notify(corsano.FILE, bytes(file[at : min(at + 20, offset + size)]))

        def send() -> None:
            record = corsano.ActivityRecord(
                int(time.time()), 66, 1.0, 3, 97, 0.5, 14.0, 0.75, 0.7, 33.5, True
            )
            file.extend(corsano.build_record(record))

        one.on_write = answer
        kind = type("Bracelet", (CorsanoDriver,), one.backends())
        driver = kind("sensor-1", CorsanoSettings(poll_s=0.02))
        return Device(driver, send, lambda: one.notify(corsano.FILE, os.urandom(37)), one.drop)


class TestLsl(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Iterator[Device]:
        import pylsl

        name = f"handover-{os.getpid()}-{np.random.default_rng().integers(1 << 30)}"

        def outlet() -> Any:
            return pylsl.StreamOutlet(pylsl.StreamInfo(name, "ECG", 1, 100, "double64", name))

        streams = [outlet()]

        def lose() -> None:
            streams.clear()
            streams.append(outlet())

        settings = LslSettings(kind="ecg", unit="D82", rate_hz=100, name=name, search_s=2)
        yield Device(LslDriver("stream", settings), lambda: streams[0].push_chunk([[1.0], [2.0]]), lose=lose)
        streams.clear()


class LosingVendor(Vendor):
    """It refuses the next token that is asked for after `lose`."""

    is_refusing = False

    def lose(self) -> None:
        self.is_refusing = True
        self.tokens.clear()

    def answer(self, method: str, target: str, headers: dict[str, str], body: str) -> tuple[int, Any]:
        if target == "/token" and self.is_refusing:
            self.is_refusing = False
            return 401, {"error": "invalid_client"}
        return super().answer(method, target, headers, body)


class TestVivalink(SensorDriverContract):
    @pytest.fixture
    async def device(self) -> AsyncIterator[Device]:
        vendor = LosingVendor()
        server = await asyncio.start_server(vendor.serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        url = f"http://127.0.0.1:{port}"
        settings = CloudSettings.model_validate(
            {"base_url": url, "token_url": f"{url}/token", "client_id": "us", "client_secret": "se&cret",
             "device_id": "patch/1", "poll_s": 0.02}
        )  # fmt: skip

        def send() -> None:
            vendor.rows = [{"time": time.time() * 1000, "hr": 70, "rr": 14, "temperature": 33.0}]

        def send_rubbish() -> None:
            vendor.rows = [{"time": "noon", "hr": []}]

        yield Device(VivalinkDriver("patch", settings), send, send_rubbish, vendor.lose)
        server.close()


class TestRosTopic(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Device:
        from cyclonedds.core import Policy, Qos
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic

        domain = ros_domain()
        made = type_of(SignalKind.ECG)
        participant = DomainParticipant(domain)
        qos = Qos(Policy.Reliability.BestEffort, Policy.DataRepresentation(use_cdrv0_representation=True))
        writer = DataWriter(participant, Topic(participant, "rt/ecg", made), qos=qos)

        def write(unit: str) -> None:
            info = SignalInfo(SignalKind.ECG, unit, 130.0, ("I",))
            ((_, message),) = messages_of(Samples("h10", info, time.time(), np.array([[100.0], [250.0]])))
            writer.write(as_dds(made, message))

        settings = RosTopicSettings(
            topic="/ecg", kind=SignalKind.ECG, unit="D82", rate_hz=130.0, channels=("I",), domain=domain
        )
        return Device(RosTopicDriver("strap", settings), lambda: write("D82"), lambda: write("CEL"))
