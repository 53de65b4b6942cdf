"""The ROS graph: topics, services and actions of robots, with one interface for all middlewares."""
