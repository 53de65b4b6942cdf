"""A server that answers late, through an adapter: the action `/slow` and the service `/slow_call`.

`slow_peer.py ADAPTER DOMAIN FOLDER` writes "ready" and runs until its input ends. It blocks each request
until the file `answer` is in the folder, and works on a goal until that is cancelled. It writes what happens
to `log`.
"""

import asyncio
import sys
import time
from pathlib import Path
from typing import Any

from handover_ros.graph.joining import Adapter, JoinSettings, join
from handover_ros.graph.port import GoalEnded, GoalStatus, ServedGoal
from handover_ros.types.type_store import TypeStore

TYPES = Path(__file__).parent / "types"


def main() -> None:
    adapter, domain, folder = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])

    def log(word: str) -> None:
        with (folder / "log").open("a") as file:
            file.write(f"{word}\n")

    def block(_: Any) -> bool:
        log("asked")
        while not (folder / "answer").exists():
            time.sleep(0.02)
        return True

    async def work(goal: ServedGoal) -> dict[str, Any]:
        log("started")
        await goal.wait_cancel_requested()
        log("cancelled")
        raise GoalEnded(GoalStatus.CANCELED)

    async def answer(request: dict[str, Any]) -> dict[str, Any]:
        return {"success": block(request), "message": "late"}

    async def run() -> None:
        settings = JoinSettings(node="slow", domain_id=domain, interfaces=("127.0.0.1",))
        graph = await join(TypeStore([TYPES]), settings, Adapter(adapter))
        await graph.serve("/slow_call", "std_srvs/srv/Trigger", answer)
        await graph.serve_action("/slow", "test_msgs/action/Fibonacci", work, accept=block)
        print("ready", flush=True)
        await asyncio.to_thread(sys.stdin.read)
        await graph.close()

    asyncio.run(run())


main()
