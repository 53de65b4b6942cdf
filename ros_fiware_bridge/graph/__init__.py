"""The ROS graph: topics, services and actions of robots, reached in one way whatever carries them."""
