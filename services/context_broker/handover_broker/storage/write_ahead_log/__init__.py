"""The write-ahead log before an SQLite file: a commit is one frame, flushed before its writers are answered.

SQLite writes whole pages for a change of some hundred bytes, and calls back into the interpreter for each
statement. A frame is one write, into space that the file has already: flushing a growing file costs the disk
four times as much. Two files of a fixed size are used in turn; a file is overwritten once its content is in
the tables. So the log stays small, and is read quickly after a crash.

| module | content |
|---|---|
| `frames` | the format of the files: header, frames, sectors, checksums |
| `log_file`, `log` | one file; the log of two files, which is appended to and read after a crash |
| `records` | the content of a frame: what one commit writes, as named, versioned records |
| `checkpoint` | copies commits from the log to the tables |
| `inspection` | the log in readable form, for `handover broker inspect` |

`docs/reference/write-ahead-log.md` describes the format; a test reads a log by that page alone.
"""
