import pytest

from handover_ros.types.type_store import TypeStore

pytest.importorskip("rosbags")


@pytest.fixture(scope="module")
def store() -> TypeStore:
    return TypeStore()


# What genuine ROS 2 programs announce (generated headers and recorded discovery data of Iron and Jazzy).
@pytest.mark.parametrize(
    ("type_name", "begins"),
    [
        ("std_msgs/msg/String", "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
        (
            "example_interfaces/srv/AddTwoInts",
            "e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a",
        ),
        ("action_msgs/srv/CancelGoal", "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"),
        ("example_interfaces/action/Fibonacci_SendGoal", "d1a57fb2a4afe8c21e34fb10db206f16ce6729b2"),
        ("example_interfaces/action/Fibonacci_GetResult", "1b0de0d5d29dc955d92f54670656842863277"),
        ("control_msgs/action/FollowJointTrajectory", "738ebcb7a2d7cfa42f9f1001cc99ce3a4383d1cf"),
        ("control_msgs/action/FollowJointTrajectory_Goal", "8a9060704b269608f5a340934cc26e66869dd14b"),
        ("control_msgs/action/FollowJointTrajectory_Result", "8002e99ed2c14c6faa522f2a93c26d744c5982f2"),
        ("control_msgs/action/FollowJointTrajectory_Feedback", "3fd0aaecf71725121ae1ff7f01098a5e0da581e6"),
        ("control_msgs/action/FollowJointTrajectory_SendGoal", "b13789dddc325a7a962825c45e28c77d37237ec1"),
        (
            "control_msgs/action/FollowJointTrajectory_SendGoal_Request",
            "179c93691f1f6d1d115881ff88c3917b7cc6eac2",
        ),
        ("control_msgs/action/FollowJointTrajectory_GetResult", "e3ceb38e3e1867c8dc0f46014df26e90eb93422f"),
    ],
)
def test_hashes_equal_those_of_genuine_peers(store: TypeStore, type_name: str, begins: str) -> None:
    assert store.hash(type_name).startswith(f"RIHS01_{begins}")


def test_a_char_is_hashed_as_uint8(store: TypeStore) -> None:
    # service_msgs/msg/ServiceEventInfo has a char[16], and stands in the hash of every service.
    assert store.hash("service_msgs/msg/ServiceEventInfo").startswith(
        "RIHS01_41bcbbe07a75c9b52bc96bfd5c24d7f0"
    )
