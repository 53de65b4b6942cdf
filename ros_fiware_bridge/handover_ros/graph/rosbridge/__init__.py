"""The graph over a rosbridge server, for ROS 1 and for robots that DDS cannot reach."""
