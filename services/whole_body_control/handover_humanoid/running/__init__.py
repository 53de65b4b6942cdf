"""The service process of a humanoid: everything about it that is not real-time."""
