"""The peer of the contract tests: a node in its own process that answers their requests.

`peer.py ADAPTER DOMAIN [TYPE_PATH…]` writes "ready" and runs until its input ends.
"""

import asyncio
import sys
from pathlib import Path
from typing import Any

import numpy as np

from handover_ros.errors import GraphError
from handover_ros.graph.joining import Adapter, JoinSettings, join
from handover_ros.graph.port import GoalEnded, GoalStatus, ServedGoal
from handover_ros.graph.qos import LATCHED, SENSOR_DATA, Qos
from handover_ros.types.type_store import TypeStore

TYPES = Path(__file__).parent / "types"


async def repeat(request: dict[str, Any]) -> dict[str, Any]:
    if request["depth"] == 13:
        raise RuntimeError("an unlucky number")
    if request["depth"] == 99:
        await asyncio.sleep(3)
    return {"result": {"names": request["prefixes"] * request["depth"]}}


async def fibonacci(goal: ServedGoal) -> dict[str, Any]:
    numbers = [0, 1]
    order = goal.request["order"]
    while len(numbers) < order:
        numbers.append(numbers[-1] + numbers[-2])
        goal.feedback({"sequence": numbers})
        if goal.cancel_requested:
            raise GoalEnded(GoalStatus.CANCELED, {"sequence": numbers})
        if order == 40 and len(numbers) == 5:
            raise GoalEnded(GoalStatus.ABORTED, {"sequence": numbers})
        if order == 41:
            raise RuntimeError("a fault in the robot")
        await asyncio.sleep(0.01)
    return {"sequence": numbers}


async def answers(graph: Any, own_types: bool) -> None:
    echo = await graph.publisher("/echo", "sensor_msgs/msg/JointState")
    await graph.subscribe("/say", "sensor_msgs/msg/JointState", lambda got: echo.publish(got.message))
    greeting = await graph.publisher("greeting", "std_msgs/msg/String", LATCHED)
    for word in ("overtaken", "welcome"):
        greeting.publish({"data": word})
    await graph.serve("/repeat", "rcl_interfaces/srv/ListParameters", repeat)
    await graph.serve_action(
        "/fibonacci",
        "test_msgs/action/Fibonacci",
        fibonacci,
        accept=lambda goal: goal["order"] < 1000,
    )

    numbered = await graph.publisher("/numbered", "std_msgs/msg/UInt32", Qos(depth=1000))

    def count(received: Any) -> None:
        for number in range(received.message["data"]):
            numbered.publish({"data": number})

    await graph.subscribe("/count", "std_msgs/msg/UInt32", count)

    asked = await graph.publisher("/asked", "std_msgs/msg/String")
    tasks = set()

    async def ask(what: str) -> None:
        try:
            answer = str((await graph.call(what, "std_srvs/srv/Trigger", {}, 2.0))["message"])
        except GraphError as error:
            answer = type(error).__name__
        asked.publish({"data": answer})

    def on_ask(received: Any) -> None:
        task = asyncio.ensure_future(ask(received.message["data"]))
        tasks.add(task)
        task.add_done_callback(tasks.discard)

    await graph.subscribe("/ask", "std_msgs/msg/String", on_ask)

    noise = await graph.publisher("/noise", "std_msgs/msg/Float32", SENSOR_DATA)
    image = await graph.publisher("/image", "sensor_msgs/msg/Image")
    own = None
    if own_types:
        own = await graph.publisher("/part", "cell_msgs/msg/Part")
    while True:
        await asyncio.sleep(0.05)
        noise.publish({"data": 0.5})
        if image.subscribers():
            image.publish({"data": np.zeros(2_000_000, np.uint8)})
        if own is not None:
            own.publish({"count": 7})


async def main() -> None:
    adapter, domain, *paths = sys.argv[1:]
    settings = JoinSettings(node="peer", namespace="/cell", domain_id=int(domain), interfaces=("127.0.0.1",))
    graph = await join(TypeStore([TYPES, *map(Path, paths)]), settings, Adapter(adapter))
    work = asyncio.ensure_future(answers(graph, bool(paths)))
    print("ready", flush=True)
    ended = asyncio.ensure_future(asyncio.to_thread(sys.stdin.read))
    await asyncio.wait([work, ended], return_when=asyncio.FIRST_COMPLETED)
    if work.done():
        work.result()
    work.cancel()
    await graph.close()


asyncio.run(main())
