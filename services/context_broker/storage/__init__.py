"""What survives: the journal, the database under it, and the memory above it."""
