"""Running: rules at work between a ROS graph and a broker."""
