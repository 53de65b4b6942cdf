"""What commands share that run a cell in the foreground, until Ctrl-C or SIGTERM."""

import asyncio
import os
import signal
from collections.abc import Coroutine
from pathlib import Path
from typing import Annotated, Any

import typer

from handover.settings import Settings

DataDir = Annotated[Path | None, typer.Option("--data-dir", help="The directory of all persistent data.")]


def say(line: str) -> None:
    """Print a line without buffering."""
    print(line, flush=True)


def settings_in(data_dir: Path | None) -> Settings:
    """Return the settings, with `data_dir` for this process and its children if it is given."""
    if data_dir is not None:
        os.environ["HANDOVER_DATA_DIR"] = str(data_dir.absolute())
    return Settings.load()


def until_stopped(work: Coroutine[Any, Any, None]) -> None:
    """Run `work` until it ends or until Ctrl-C or SIGTERM."""

    async def watched() -> None:
        task = asyncio.ensure_future(work)
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, task.cancel)
        try:
            await task
        except asyncio.CancelledError:
            say("stopped")

    asyncio.run(watched())
