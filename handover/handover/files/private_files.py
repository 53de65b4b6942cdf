"""Private files: nobody but the user of the services reads what they store.

A service creates files with the umask 077, and at its start takes the permissions of others from the data
directory and what is in it. Where the directory belongs to another user, as with `fsGroup` of Kubernetes, its
group may read and write (0770 and 0660): the platform gives it to this service alone.

The folders in `SHARED` are left alone: others read certificates and public keys there, and each private file
in them has its own mode.
"""

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

UMASK: Final = 0o077
SHARED: Final = frozenset({"tls", "security", "cell"})
DEPTH: Final = 2
"""So many levels are repaired: what is deeper is behind folders that only their owner can enter."""
_OF_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO


def make_private(data_dir: Path) -> Iterator[str]:
    """Take the permissions of others from the data directory; yield a line about what has changed or cannot.

    Does nothing on Windows, where files inherit the rights of the folder of the user.
    """
    if os.name != "posix":
        return
    os.umask(UMASK)
    if data_dir.stat().st_mode & stat.S_ISVTX:
        yield f"{data_dir} is shared with other users and stays as it is; use a directory of its own"
        return
    repaired: list[Path] = []
    for path, status in _entries(data_dir):
        if status.st_uid == os.geteuid() and status.st_mode & _OF_OTHERS:
            try:
                path.chmod(stat.S_IMODE(status.st_mode) & ~_OF_OTHERS)
            except OSError as error:
                yield f"{path} can be read by others, and its mode cannot be changed: {error.strerror}"
            else:
                repaired.append(path)
    if repaired:
        yield f"others could read {_named(repaired)}; only the user of the service can now"
    yield from faults_of(data_dir)


def faults_of(data_dir: Path) -> Iterator[str]:
    """Yield what others can read of the data directory, with the way out."""
    if os.name != "posix":
        return
    for path, status in _entries(data_dir):
        is_own = status.st_uid == os.geteuid()
        if status.st_mode & (_OF_OTHERS if is_own else stat.S_IRWXO):
            mode = stat.S_IMODE(status.st_mode)
            way_out = (
                "the next start of a service repairs it"
                if is_own
                else f"it belongs to user {status.st_uid}, who can repair it: chmod o-rwx"
            )
            yield f"{path} can be read by others (mode {mode:04o}); {way_out}"


def owner_of(data_dir: Path) -> str | None:
    """Return a line about a data directory of another user that is accepted; None for an own one."""
    if os.name != "posix" or not data_dir.exists():
        return None
    status = data_dir.stat()
    if status.st_uid == os.geteuid() or status.st_mode & stat.S_IRWXO:
        return None
    return (
        f"{data_dir} belongs to user {status.st_uid} (mode {stat.S_IMODE(status.st_mode):04o}): its group "
        f"{status.st_gid} may read and write, as with fsGroup of Kubernetes"
    )


def _entries(data_dir: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield the files and folders of the data directory with their status; links are not followed."""
    pending = [(data_dir, 0)]
    while pending:
        path, depth = pending.pop()
        try:
            status = path.lstat()
            is_folder = stat.S_ISDIR(status.st_mode)
            inside = list(path.iterdir()) if is_folder and depth < DEPTH else []
        except OSError:  # another service has just deleted it, or nobody but its owner can enter
            continue
        if is_folder or stat.S_ISREG(status.st_mode):
            yield path, status
        pending += [(inner, depth + 1) for inner in inside if depth > 0 or inner.name not in SHARED]


def _named(paths: list[Path]) -> str:
    more = len(paths) - 1
    return f"{paths[0]}" + (f" and {more} more files or folders in it" if more else "")
