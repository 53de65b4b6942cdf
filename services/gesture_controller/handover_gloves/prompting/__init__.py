"""What a Task asks a person to show, and the progress towards it."""
