"""The graph over an installed ROS (rclpy): with its middleware, its security and its services."""
