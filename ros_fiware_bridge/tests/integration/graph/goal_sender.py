"""A program that sends a goal to `/slow` and waits for its result, until it is killed.

`goal_sender.py ADAPTER DOMAIN GOALS_FILE` writes "ready" before it sends.
"""

import asyncio
import sys
from pathlib import Path

from handover_ros.graph.joining import Adapter, JoinSettings, join
from handover_ros.types.type_store import TypeStore

TYPES = Path(__file__).parent / "types"


async def main() -> None:
    adapter, domain, file = sys.argv[1:]
    settings = JoinSettings(
        node="sender", domain_id=int(domain), interfaces=("127.0.0.1",), goals_file=Path(file)
    )
    graph = await join(TypeStore([TYPES]), settings, Adapter(adapter))
    action = await graph.action_client("/slow", "test_msgs/action/Fibonacci")
    print("ready", flush=True)
    await (await action.send_goal({"order": 900}, timeout_s=600)).result()


asyncio.run(main())
