"""Motion engines: what to do, as tasks, becomes joint motion."""
