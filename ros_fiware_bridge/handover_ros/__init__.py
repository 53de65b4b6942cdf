"""The ROS bridge: maps a ROS 2 graph to NGSI-LD entities and back, by rules in YAML."""
