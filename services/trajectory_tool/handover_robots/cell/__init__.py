"""A cell: its robots, the scene that they share, and the state that survives a power cut."""
