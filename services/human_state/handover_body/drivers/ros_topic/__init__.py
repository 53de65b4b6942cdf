"""Any ROS 2 topic of the package handover_human_msgs, over DDS, without an installation of ROS."""
