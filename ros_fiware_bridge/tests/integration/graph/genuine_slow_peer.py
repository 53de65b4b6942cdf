"""The server of `slow_peer.py` as a genuine ROS 2 node, written with rclpy alone.

`genuine_slow_peer.py DOMAIN FOLDER` writes "ready" and runs until its input ends.
"""

import contextlib
import sys
import threading
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci


def main() -> None:
    folder = Path(sys.argv[2])
    rclpy.init(domain_id=int(sys.argv[1]))
    node = rclpy.create_node("slow")
    group = ReentrantCallbackGroup()

    def log(word: str) -> None:
        with (folder / "log").open("a") as file:
            file.write(f"{word}\n")

    def block(_: Any) -> GoalResponse:
        log("asked")
        while not (folder / "answer").exists():
            time.sleep(0.02)
        return GoalResponse.ACCEPT

    def work(goal: Any) -> Any:
        log("started")
        while not goal.is_cancel_requested:
            time.sleep(0.02)
        goal.canceled()
        log("cancelled")
        return Fibonacci.Result()

    def answer(request: Any, response: Any) -> Any:
        block(request)
        response.success, response.message = True, "late"
        return response

    node.create_service(Trigger, "/slow_call", answer, callback_group=group)
    ActionServer(
        node,
        Fibonacci,
        "/slow",
        work,
        callback_group=group,
        goal_callback=block,
        cancel_callback=lambda _: CancelResponse.ACCEPT,
    )
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True).start()
    print("ready", flush=True)
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(node, MultiThreadedExecutor(4))


main()
