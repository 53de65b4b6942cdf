"""The page server asks `accounts`: an answer that is missing is no refusal, since the change may be made."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from handover.errors import Problem
from handover.security.access_tokens import SigningKey, key_set
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover_web.http.page_guard import PageGuard
from handover_web.settings import WebuiSettings
from tests.kit.ports import next_free_port
from tests.kit.rubbish_source import RubbishSource


@pytest.fixture
def accounts() -> Iterator[RubbishSource]:
    source = RubbishSource()
    yield source
    source.stop()


async def problem_of(folder: Path, url: str, path: str) -> Problem:
    (folder / "security").mkdir(exist_ok=True)
    (folder / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(SigningKey.generate()))
    given = {"accounts_url": url, "service_token": "hnd_script_" + "a" * 43}  # is not exchanged
    guard = PageGuard(WebuiSettings(data_dir=folder, _env_file=None, **given))
    try:
        with pytest.raises(Problem) as raised:
            await guard.ask_accounts(path, {"link": "hnd_link_x"})
    finally:
        guard.access.close()
    return raised.value


def answer(status: int) -> bytes:
    body = b'{"title": "Refused", "status": %d, "detail": "for a reason"}' % status
    return b"HTTP/1.1 %d X\r\nContent-Length: %d\r\n\r\n" % (status, len(body)) + body


@pytest.mark.parametrize(
    ("pieces", "status"),
    [
        ([], 504),
        ([answer(200)[:30]], 504),
        ([b"rubbish\r\n\r\n"], 504),
        ([b"HTTP/1.1 200 OK\r\nContent-Length: 1\r\n\r\n{"], 504),
        ([answer(500)], 504),
        ([answer(503)], 503),
        ([answer(409)], 409),
    ],
)
async def test_a_one_time_link_that_may_have_been_used_is_not_called_refused(
    accounts: RubbishSource, tmp_path: Path, pieces: list[bytes], status: int
) -> None:
    accounts.says(*pieces)
    problem = await problem_of(tmp_path, accounts.url, "/links/use")
    assert problem.status == status
    assert ("see whether it is done" in problem.detail) == (status == 504)


async def test_what_was_not_sent_or_changes_nothing_is_refused(
    accounts: RubbishSource, tmp_path: Path
) -> None:
    away = f"http://127.0.0.1:{next_free_port()}"
    assert (await problem_of(tmp_path, away, "/links/use")).status == 503
    accounts.says()
    assert (await problem_of(tmp_path, accounts.url, "/links/preview")).status == 503
