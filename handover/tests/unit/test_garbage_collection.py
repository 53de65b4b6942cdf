"""What was loaded is frozen, also what is imported later, and what is made afterwards is still collected."""

import asyncio
import gc
import sys
import weakref
from collections.abc import Iterator
from pathlib import Path

import pytest

from handover.runtime.garbage_collection import freeze_loaded
from tests.kit.waiting import until


@pytest.fixture(autouse=True)
def nothing_frozen() -> Iterator[None]:
    yield
    gc.unfreeze()


class Ring:
    """An object that only the garbage collection removes."""

    def __init__(self) -> None:
        self.me = self


async def test_modules_are_frozen_when_they_come_and_rings_are_still_collected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "loaded_late.py").write_text("RINGS = [[] for _ in range(5000)]")
    monkeypatch.syspath_prepend(tmp_path)
    freezing = asyncio.create_task(freeze_loaded(check_every_s=0.01))
    await until(lambda: gc.get_freeze_count() > 0)
    before = gc.get_freeze_count()
    __import__("loaded_late")
    await until(lambda: gc.get_freeze_count() >= before + 5000)
    ring = weakref.ref(Ring())
    gc.collect()
    assert ring() is None
    del sys.modules["loaded_late"]
    freezing.cancel()
