"""What is stored of a process, and the entities that are written of it."""
