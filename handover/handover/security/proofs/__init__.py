"""What `accounts` signs about a Task, so that it holds in every broker: a PIN, and who performed it."""
