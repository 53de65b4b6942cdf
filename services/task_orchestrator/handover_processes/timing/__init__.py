"""When something is due: timers, deadlines, retries, escalations."""
