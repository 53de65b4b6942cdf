"""The reasons for which tests may skip in CI."""

import os

NOT_OURS = "are not here"
"""Part of the reason of tests that use published examples and recordings, where those are absent."""

NO_ROS = "rclpy is not installed; make ros-test runs these tests"
"""The reason of tests against genuine ROS 2 nodes. Not allowed in `make ros-test`."""

ROS_TYPES = "an installed ROS knows only types that were built for it"
"""The reason of tests with message types of their own, on rclpy."""

NO_IPV6 = "this machine has no IPv6"
"""The reason of tests of IPv6: containers often have none."""

NO_MOUNT = "no small file system can be mounted here, which needs root"
"""The reason of tests with a full disk."""

NO_FAKETIME = "libfaketime is not installed (Debian: apt install faketime)"
"""The reason of tests that move the clock of processes."""

OTHER_BROKER = "the broker is another one"
"""The reason of tests of what our own broker refuses, in `make orion-test`."""


def is_allowed_to_skip(reason: str) -> bool:
    """Return whether a test may skip for `reason`: outside CI and `make ros-test` for any."""
    with_ros = bool(os.environ.get("HANDOVER_TEST_ROS"))
    if not os.environ.get("CI") and not with_ros:
        return True
    allowed = (NOT_OURS, NO_IPV6, NO_MOUNT, NO_FAKETIME, OTHER_BROKER, ROS_TYPES if with_ros else NO_ROS)
    return any(part in reason for part in allowed)
