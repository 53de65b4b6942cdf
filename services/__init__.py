"""The services: each a process of its own; they know the kit and meet in the broker, never each other."""
