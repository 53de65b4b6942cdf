"""Log files, and lines that repeat."""
