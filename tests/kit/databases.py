"""The database of services in tests: SQLite in their data directory, or PostgreSQL (`make thorough`).

With `HANDOVER_TEST_DATABASE=postgresql` each data directory has databases of its own on the server of the
run.
"""

import functools
import os
from pathlib import Path
from typing import Final

DATABASE: Final = os.environ.get("HANDOVER_TEST_DATABASE", "sqlite")
"""The default database of tests: sqlite or postgresql."""


@functools.cache
def default_url(folder: Path, service: str = "") -> str | None:
    """Return the URL of the database of the services in `folder`; None for SQLite in the folder."""
    if DATABASE == "sqlite":
        return None
    from tests.kit.postgres import shared_server

    return shared_server().new_database()


def broker_settings(folder: Path) -> dict[str, str]:
    """Return the settings of a broker with the data directory `folder` for its database."""
    url = default_url(folder, "context_broker")
    return {} if url is None else {"HANDOVER_BROKER_DATABASE_URL": url}


def service_settings(folder: Path) -> dict[str, str]:
    """Return the settings of the services with the data directory `folder` for their database."""
    url = default_url(folder)
    return {} if url is None else {"HANDOVER_DATABASE_URL": url}
