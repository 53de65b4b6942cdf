"""The threads that hash passwords."""

import asyncio
import os
import sys
import threading

import pytest

from handover.errors import Problem
from handover_accounts.passwords import MAX_WAITING, NICENESS, PasswordHashes


def niceness() -> int:
    return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a priority for each thread")
async def test_hashes_have_a_lower_priority_than_the_requests_of_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before, found = niceness(), []
    hashes = PasswordHashes(1)
    monkeypatch.setattr(hashes, "_verify", lambda *_: found.append(niceness()))
    try:
        for is_known in (True, False):
            await hashes.verify("correct horse battery", None, is_known=is_known)
    finally:
        hashes.close()
    assert found == [max(before, NICENESS)] * 2
    assert niceness() == before


async def test_attempts_that_find_the_queue_full_are_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    hashes, may_end = PasswordHashes(1), threading.Event()
    monkeypatch.setattr(hashes, "_verify", lambda *_: may_end.wait(60))
    waiting = [hashes.verify("a password", None, is_known=False) for _ in range(MAX_WAITING + 2)]
    tasks = [asyncio.create_task(one) for one in waiting]
    try:
        with pytest.raises(Problem) as refused:
            await tasks[-1]
        assert refused.value.status == 429
        assert not any(task.done() for task in tasks[:-1])
    finally:
        may_end.set()
        await asyncio.gather(*tasks, return_exceptions=True)
        hashes.close()
