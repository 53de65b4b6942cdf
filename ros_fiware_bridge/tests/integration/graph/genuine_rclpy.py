"""A genuine ROS 2 node, written with rclpy alone: publishes `/nested` (test_msgs/msg/Nested).

`genuine_rclpy.py DOMAIN` writes "ready" and runs until its input ends.
"""

import contextlib
import sys
import threading

import rclpy
from rclpy.executors import ExternalShutdownException
from test_msgs.msg import Nested


def main() -> None:
    rclpy.init(domain_id=int(sys.argv[1]))
    node = rclpy.create_node("genuine", namespace="/cell")
    publisher = node.create_publisher(Nested, "/nested", 10)
    message = Nested()
    message.basic_types_value.int32_value = 7
    node.create_timer(0.1, lambda: publisher.publish(message))
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True).start()
    print("ready", flush=True)
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(node)


main()
