"""Work that is offloaded runs in another process, brings back what came of it, and cannot stay for ever."""

import asyncio
import os
from pathlib import Path

import pytest

from handover.runtime.offload import Offload, OffloadFailed
from tests.kit.offloaded import end_at_once, fail, fail_with_what_cannot_travel, process_id, sleep_and_mark


async def test_a_function_runs_in_a_process_of_its_own() -> None:
    assert await Offload().run(process_id) != os.getpid()


async def test_what_it_raises_is_raised_here() -> None:
    with pytest.raises(ValueError, match="no good"):
        await Offload().run(fail, "no good")
    with pytest.raises(OffloadFailed, match="FailsToTravel: one two"):
        await Offload().run(fail_with_what_cannot_travel)


async def test_a_process_that_ends_early_is_an_error() -> None:
    with pytest.raises(OffloadFailed, match="end_at_once ended with the exit code 3"):
        await Offload().run(end_at_once)


async def test_one_that_takes_too_long_is_killed(tmp_path: Path) -> None:
    offload = Offload(timeout_s=20)
    running = asyncio.create_task(offload.run(sleep_and_mark, tmp_path / "pid"))
    while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
        await asyncio.sleep(0.05)
        assert not running.done(), running.exception()
    running.cancel()  # as good as its time being up, and sooner
    with pytest.raises(asyncio.CancelledError):
        await running
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
    with pytest.raises(OffloadFailed, match="sleep_and_mark took longer"):
        await Offload(timeout_s=0.1).run(sleep_and_mark, tmp_path / "second")
