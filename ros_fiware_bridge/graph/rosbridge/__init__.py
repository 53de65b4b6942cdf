"""The ROS graph by way of a rosbridge server: ROS 1, and graphs that DDS does not reach."""
