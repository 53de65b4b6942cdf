"""ROS types: what messages, services and actions are made of, and how they look on the wire."""
