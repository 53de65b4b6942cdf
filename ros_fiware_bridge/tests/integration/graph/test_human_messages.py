"""Signals of the body between our DDS and a peer that knows handover_human_msgs from its files alone."""

import asyncio
import random
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds")

from handover_body.formats import ros
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import ClockKind, Samples, SignalInfo, SignalKind
from handover_ros.graph.joining import Adapter, JoinSettings, join
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.graph.conftest import running_script
from tests.kit.waiting import scaled


@pytest.mark.nightly
async def test_a_heart_rate_and_an_ecg_are_echoed_by_a_genuine_peer() -> None:
    info = SignalInfo(SignalKind.ECG, "D82", 130.0, ("chest",), method="chest strap, one lead")
    wave = Samples(
        "h10",
        info,
        1_770_000_000.25,
        np.arange(73.0).reshape(-1, 1),
        clock=ClockKind.DEVICE,
        has_contact=True,
    )
    rate = Feature(FeatureName.HEART_RATE, "h10", 92.5, 1_770_000_000.5, 0.9, method="ecg")
    domain = 2 * random.randint(46, 50)
    settings = JoinSettings(node="bridge", domain_id=domain, interfaces=("127.0.0.1",))
    with running_script("genuine_human_peer.py", str(domain)):
        graph = await join(TypeStore(), settings, Adapter.CYCLONE)
        try:
            typed = ros.typed_message(rate, "p-1")
            assert typed is not None
            back = await echoed(graph, "/said", "/echoed", typed)
            assert back["rate_bpm"] == 92.5
            assert back["info"]["subject"] == "p-1"
            ((name, message),) = ros.messages_of(wave, "p-1")
            found = ros.samples_of(name, await echoed(graph, "/wave_said", "/wave_echoed", (name, message)))
            assert found.values.tolist() == wave.values.tolist()
            assert (found.info, found.clock, found.has_contact) == (info, ClockKind.DEVICE, True)
        finally:
            await graph.close()


async def echoed(graph: Any, said: str, answers: str, typed: tuple[str, dict[str, Any]]) -> dict[str, Any]:
    """Publish a message until the peer, whose reader and writer are found in any order, has sent it."""
    got: asyncio.Queue[Any] = asyncio.Queue()
    subscription = await graph.subscribe(answers, typed[0], got.put_nowait)
    publisher = await graph.publisher(said, typed[0])
    assert await subscription.matched(scaled(20))
    assert await publisher.matched(scaled(20))
    while True:
        publisher.publish(typed[1])
        try:
            received = await asyncio.wait_for(got.get(), 2.0)
        except TimeoutError:
            continue
        message: dict[str, Any] = received.message
        return message
