"""Optional parts of the broker: for each the interface that the core uses, and what answers without it."""
