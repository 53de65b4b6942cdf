"""REST and WebSockets of the ROS bridge."""
