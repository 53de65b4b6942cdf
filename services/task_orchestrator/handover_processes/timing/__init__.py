"""When a Task is due: retries, escalations."""
