"""A stream of the Lab Streaming Layer that ends is lost, and found again when it is back."""

import asyncio
import subprocess
import sys
import uuid

import pytest

from handover_body.drivers.lsl.driver import LslDriver, LslSettings
from handover_body.drivers.runner import RunnerTiming, SensorRunner
from handover_body.model.signals import LinkState, Samples, SensorReport, SignalKind
from tests.kit.waiting import until

pytest.importorskip("pylsl", reason="the extra human-state is not installed", exc_type=ImportError)

OUTLET = """
import select, sys, pylsl
name = sys.argv[1]
outlet = pylsl.StreamOutlet(pylsl.StreamInfo(name, "ECG", 1, 100, "double64", name))
while not select.select([sys.stdin], [], [], 0.01)[0]:
    outlet.push_sample([1.0])
"""


async def test_an_outlet_that_ends_is_a_lost_link_and_a_new_one_is_found() -> None:
    name = f"ecg-{uuid.uuid4().hex[:8]}"
    settings = LslSettings(kind=SignalKind.ECG, unit="D82", rate_hz=100, name=name, search_s=60)
    samples: list[Samples] = []
    reports: list[SensorReport] = []

    def sink(item: Samples | SensorReport) -> None:
        (samples if isinstance(item, Samples) else reports).append(item)  # type: ignore[arg-type]

    def outlet() -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, "-c", OUTLET, name], stdin=subprocess.PIPE)

    def lost() -> list[SensorReport]:
        return [report for report in reports if report.link in {LinkState.LOST, LinkState.FAULT}]

    timing = RunnerTiming(initial_reconnect_s=0.05, max_reconnect_s=0.2, max_silence_s=600)
    runner = SensorRunner(LslDriver("lsl", settings), sink, timing=timing)
    running = asyncio.create_task(runner.run())
    sender = outlet()
    try:
        await until(lambda: samples)
        sender.kill()
        sender.communicate()
        await until(lost)
        assert lost()[0].link is LinkState.LOST
        assert "the LSL stream was lost: " in lost()[0].text
        assert lost()[0].text.partition("lost: ")[2]
        sender, before = outlet(), len(samples)
        await until(lambda: len(samples) > before + 5)
    finally:
        sender.kill()
        sender.communicate()
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
