"""The sensor driver of ROS topics reads what the bridge's graph publishes."""

import asyncio
import time
from contextlib import suppress
from typing import Any

import numpy as np

from handover_body.drivers.ros_topic.driver import RosTopicDriver, RosTopicSettings
from handover_body.drivers.runner import SensorRunner
from handover_body.drivers.simulated.driver import SimulatedDriver, SimulatedSettings
from handover_body.formats.ros import messages_of
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import Samples, SensorReport, SignalInfo, SignalKind
from handover_body.monitoring.processors import pipeline_of
from handover_ros.graph.joining import Adapter, JoinSettings, join
from handover_ros.types.type_store import TypeStore
from tests.kit.paths import REPOSITORY
from tests.kit.ros_domains import ros_domain
from tests.kit.waiting import until

ECG = SignalInfo(SignalKind.ECG, "D82", 130.0, ("I",))


async def test_the_driver_reads_what_the_graph_publishes() -> None:
    domain = ros_domain()
    store = TypeStore([REPOSITORY / "ros_fiware_bridge/handover_ros/messages"])
    graph = await join(store, JoinSettings(domain_id=domain), Adapter.CYCLONE)
    settings = RosTopicSettings(
        topic="/ecg", kind=SignalKind.ECG, unit="D82", rate_hz=130.0, channels=("I",), domain=domain
    )
    items: list[Samples | SensorReport] = []
    task = asyncio.create_task(SensorRunner(RosTopicDriver("strap", settings), items.append).run())
    try:
        ((name, message),) = messages_of(Samples("h10", ECG, time.time(), np.array([[100.0], [250.0]])))
        publisher = await graph.publisher("/ecg", name)

        def publish() -> bool:
            publisher.publish(message)
            return any(isinstance(one, Samples) for one in items)

        await until(publish)
        first = next(one for one in items if isinstance(one, Samples))
        assert first.values.ravel().tolist() == [100.0, 250.0]
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await graph.close()


async def test_the_blinks_of_a_graph_of_ros4hc_become_a_blink_rate() -> None:
    domain = ros_domain()
    graph = await join(TypeStore(), JoinSettings(domain_id=domain), Adapter.CYCLONE)
    given = {"topic": "/eye/blink", "kind": "blink", "messages": "ros2_hc_msgs", "domain": domain}
    driver = RosTopicDriver("glasses", RosTopicSettings.model_validate(given))
    (info,) = driver.signals
    pipeline = pipeline_of(info, [info.kind])
    features: list[Feature] = []

    def take(item: Samples | SensorReport) -> None:
        if isinstance(item, Samples):
            features.extend(pipeline.feed(item))

    # without the runner, whose clock map expects events at their pace
    task = asyncio.create_task(driver.run(take))
    eyes = SimulatedDriver("eyes", SimulatedSettings(signals=(SignalKind.BLINK,), pace=0)).person.eyes
    begin_s, sent_s = time.time() - 600, 0.0
    try:
        publisher = await graph.publisher("/eye/blink", "ros2_hc_msgs/msg/Blink")

        def publish() -> bool:
            nonlocal sent_s
            eyes.advance(sent_s + 5)
            for began_s, ended_s in list(eyes.blinks):
                if sent_s < ended_s <= sent_s + 5:
                    publisher.publish(blink_message(began_s + begin_s, ended_s + begin_s))
            sent_s = min(sent_s + 5, 590)
            return any(one.name is FeatureName.BLINK_RATE and one.quality > 0.5 for one in features)

        await until(publish)
        rate = [one for one in features if one.name is FeatureName.BLINK_RATE][-1]
        assert 8 < float(rate.value) < 30
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await graph.close()


def blink_message(began_s: float, ended_s: float) -> dict[str, Any]:
    """Return a blink as the eye tracker of ROS4HC publishes it."""
    stamp = {"sec": int(ended_s), "nanosec": int(ended_s % 1 * 1e9)}
    return {
        "header": {"stamp": stamp, "frame_id": "pupil_glasses"},
        "duration": ended_s - began_s,
        "start_time_ns": int(began_s * 1e9),
        "end_time_ns": int(ended_s * 1e9),
    }
