"""The sensor driver of ROS topics reads what the bridge's graph publishes."""

import asyncio
import time
from contextlib import suppress

import numpy as np

from ros_fiware_bridge.graph.joining import Adapter, JoinSettings, join
from ros_fiware_bridge.types.type_store import TypeStore
from services.human_state.drivers.ros_topic.driver import RosTopicDriver, RosTopicSettings
from services.human_state.drivers.runner import SensorRunner
from services.human_state.formats.ros import messages_of
from services.human_state.model.signals import Samples, SensorReport, SignalInfo, SignalKind
from tests.kit.paths import REPOSITORY
from tests.kit.ros_domains import ros_domain
from tests.kit.waiting import until

ECG = SignalInfo(SignalKind.ECG, "D82", 130.0, ("I",))


async def test_the_driver_reads_what_the_graph_publishes() -> None:
    domain = ros_domain()
    store = TypeStore([REPOSITORY / "ros_fiware_bridge" / "messages"])
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
