"""Forms of values and files: JSON, MCAP, tables, durations, descriptions of robots."""
