"""ROS types: the definitions of messages, services and actions, and their wire format."""
