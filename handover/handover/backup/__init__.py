"""A backup: one file with everything that a cell knows, made while the cell runs, and restored elsewhere.

| module | content |
|---|---|
| `sealed_stream` | the encryption of a backup by a passphrase |
| `archive` | the file: a tar with a list of its files and checksums; written, and read with every check |
| `sqlite_snapshot` | a SQLite database as of one moment, while services write it |
| `postgres` | dumps of PostgreSQL databases |
| `contents` | what belongs to a cell, and what does not |
| `restoring` | the way back into an empty folder |

How a backup is consistent: the snapshots of all SQLite databases begin within some milliseconds, the
orchestrator's first and the broker's next. So the broker's is never older than the orchestrator's, and the
records of performers are never older than the broker's: what the orchestrator has not seen yet is applied
when it compares its Tasks after the restart, and what it sends once more has the same id. Copying follows,
and takes as long as it takes; each snapshot stays as of its moment.
"""
