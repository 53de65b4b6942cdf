"""Folders that tests read."""

from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
RECORDINGS = REPOSITORY.parent / "shared" / "data" / "glove_recordings"
"""Recordings of real gloves, beside the repository; absent on most machines."""
