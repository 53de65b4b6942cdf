"""The graph over DDS from a wheel: the wire protocol of ROS 2 without a ROS installation."""
