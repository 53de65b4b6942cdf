"""Recordings of body signals: encrypted MCAP files that somebody starts and stops."""
