"""Loss and damage of a SQLite database are detected by two files beside it.

SQLite stores no checksums of its pages, and it ends a write-ahead log silently at the first damaged frame. So
each database of ours has

- `<name>.stamp` with the number of its header (`application_id`) and the number of the last commit. Each
  commit increments that number in the table `handover_commits` too. If the database has fewer commits than
  the stamp, acknowledged changes are missing;
- `<name>.pages` with a checksum of each page of the database file as of the last checkpoint. Pages of which
  the write-ahead log has a newer copy are not compared: SQLite replaces them.

Only our checkpoints may change the database file, so SQLite's automatic ones are disabled. A file that
another program has checkpointed is checked by SQLite's integrity check alone.
"""
