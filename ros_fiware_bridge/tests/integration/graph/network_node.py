"""A node for the tests of networks: publishes or prints `/hello` until its input ends.

`network_node.py publish|subscribe SETTINGS` with the settings of `JoinSettings` as JSON.
"""

import asyncio
import json
import sys

from handover_ros.graph.joining import Adapter, JoinSettings, join
from handover_ros.graph.qos import LATCHED
from handover_ros.types.type_store import TypeStore


async def main() -> None:
    role, given = sys.argv[1], json.loads(sys.argv[2])
    settings = JoinSettings(
        **{name: tuple(one) if isinstance(one, list) else one for name, one in given.items()}
    )
    graph = await join(TypeStore(), settings, Adapter.CYCLONE)
    if role == "publish":
        publisher = await graph.publisher("/hello", "std_msgs/msg/String", LATCHED)
        publisher.publish({"data": "from the robot"})
    else:
        await graph.subscribe(
            "/hello",
            "std_msgs/msg/String",
            lambda received: print(received.message["data"], flush=True),
            LATCHED,
        )
    print("ready", flush=True)
    await asyncio.to_thread(sys.stdin.read)
    await graph.close()


asyncio.run(main())
