"""The ROS bridge: what happens on a ROS 2 graph becomes entities and attributes, and the other way."""
