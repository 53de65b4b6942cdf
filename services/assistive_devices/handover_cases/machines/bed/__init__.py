"""A bed that rocks a sleeper, and lifts the backrest of one who is restless."""
