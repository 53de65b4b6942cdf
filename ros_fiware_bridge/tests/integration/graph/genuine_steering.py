"""A genuine ROS 2 node that walks a humanoid ahead, written with rclpy alone.

`genuine_steering.py DOMAIN WISH JOINT_STATES` writes "ready" and runs until its input ends. Each wish has the
stamp of the newest state; each fortieth is zero, which releases the dead-man control where messages were
late.
"""

import contextlib
import itertools
import sys
import threading

import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState


def main() -> None:
    rclpy.init(domain_id=int(sys.argv[1]))
    node = rclpy.create_node("steering")
    wishes = node.create_publisher(TwistStamped, sys.argv[2], 10)
    newest, numbers = [], itertools.count()

    def see(state: JointState) -> None:
        newest[:] = [state.header.stamp]

    def steer() -> None:
        if newest:
            wish = TwistStamped()
            wish.header.stamp = newest[0]
            wish.twist.linear.x = 0.08 if next(numbers) % 40 else 0.0
            wishes.publish(wish)

    node.create_subscription(JointState, sys.argv[3], see, qos_profile_sensor_data)
    node.create_timer(0.05, steer)
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True).start()
    print("ready", flush=True)
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(node)


main()
