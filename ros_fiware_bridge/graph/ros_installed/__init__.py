"""The graph over the ROS that is installed (rclpy): for its middleware, its security and its services."""
