"""Commands for the Python processes that we start: with this interpreter and a safe path.

`python -m` and `python -c` import from the working directory first, `python -P` does not. The working
directory is the folder of a user: a `random.py`, a `queue.py` or a folder `services` there would replace the
module that a service needs. `PYTHONPATH` counts as before.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module with this interpreter and a safe path."""
    return [sys.executable, "-P", "-m", module, *arguments]


def code_command(code: str) -> list[str]:
    """Return the command that runs `code` with this interpreter, as `module_command` runs a module."""
    return [sys.executable, "-P", "-c", code]


@contextmanager
def safe_path_in_workers() -> Iterator[None]:
    """Give a safe path to the processes that `multiprocessing` spawns within the context.

    It builds their command from the flags of this interpreter, which a person started.
    """
    name = "PYTHONSAFEPATH"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
