"""A genuine ROS 2 node of a humanoid, written with rclpy alone: its joints follow the commands.

`genuine_humanoid.py DOMAIN WRENCH_TOPICS JOINTS`, both with commas, writes "ready" and runs until its input
ends.
"""

import contextlib
import sys
import threading

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, JointState


def main() -> None:
    rclpy.init(domain_id=int(sys.argv[1]))
    topics, names = sys.argv[2].split(","), sys.argv[3].split(",")
    node = rclpy.create_node("humanoid")
    positions = dict.fromkeys(names, 0.0)
    joints = node.create_publisher(JointState, "/joint_states", qos_profile_sensor_data)
    imu = node.create_publisher(Imu, "/imu", qos_profile_sensor_data)
    wrenches = [node.create_publisher(WrenchStamped, topic, qos_profile_sensor_data) for topic in topics]

    def follow(command: JointState) -> None:
        positions.update(zip(command.name, command.position, strict=False))

    def report() -> None:
        turning, state = Imu(), JointState()
        turning.linear_acceleration.z = 9.81
        imu.publish(turning)
        for publisher in wrenches:
            wrench = WrenchStamped()
            wrench.wrench.force.z = 100.0
            publisher.publish(wrench)
        state.header.stamp = node.get_clock().now().to_msg()
        state.name, state.position = list(positions), list(positions.values())
        state.velocity = state.effort = [0.0] * len(names)
        joints.publish(state)

    node.create_subscription(JointState, "/joint_commands", follow, 10)
    node.create_timer(0.01, report)
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True).start()
    print("ready", flush=True)
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(node)


main()
