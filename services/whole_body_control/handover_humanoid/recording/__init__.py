"""The logger: what the control cycle did, as MCAP files for analysis and replay. It is not real-time."""
