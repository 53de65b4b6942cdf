"""Endpoints whose node is not known yet are described for people."""

from handover_ros.graph.port import Endpoint
from handover_ros.graph.qos import SENSOR_DATA


def test_a_publisher_whose_node_is_not_known_yet_is_not_called_none() -> None:
    unknown = Endpoint(None, "std_msgs/msg/String", SENSOR_DATA, None, "fastdds", ours=False)
    assert unknown.shown_node == "a node without a name yet (fastdds)"
    known = Endpoint("/arm", "std_msgs/msg/String", SENSOR_DATA, None, "fastdds", ours=False)
    assert known.shown_node == "/arm"
