"""Files that survive a power cut, are private, or belong to one process."""
