"""The control cycle: a process of its own that shares memory with the rest, and needs nothing of it."""
