"""Snapshots: results of queries, stored at one moment and queried later."""
