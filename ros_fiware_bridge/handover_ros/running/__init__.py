"""Runs compiled rules between a ROS graph and a broker."""
