"""The case studies of ROS4HC: machines that follow the state of a person."""
