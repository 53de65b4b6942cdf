"""Folders that tests read."""

from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
TEST_FOLDERS = (
    REPOSITORY / "tests",
    *sorted(REPOSITORY.glob("*/tests")),
    *sorted(REPOSITORY.glob("services/*/tests")),
)
RECORDINGS = REPOSITORY.parent / "shared" / "data" / "glove_recordings"
"""Recordings of real gloves, beside the repository; absent on most machines."""
