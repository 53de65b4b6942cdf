"""Accounts whose keys are missing or damaged: every service refuses to start and names the file."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from handover.errors import UsageError
from handover.security.guard import Guard
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.revocations import FollowedRevocations
from handover.security.service_access import AccountsUnavailable, ServiceAccess
from handover.settings import SERVICE_TOKENS_FOLDER, SIGNING_KEYS_FILE, Settings
from handover_accounts.check import faults_in
from handover_accounts.set_up import owner_link, set_up
from handover_accounts.settings import AccountsSettings
from handover_accounts.storage.changes import Store
from services.accounts.tests.unit.conftest import Accounts, running


async def start(settings: Settings, service: str = "lamp") -> None:
    async with Guard(settings, service, revocations=FollowedRevocations()):
        pass


def without_public_keys(settings: Settings) -> Path:
    file = settings.security_folder / PUBLIC_KEYS_FILE
    file.unlink()
    return file


def without_security_folder(settings: Settings) -> Path:
    shutil.rmtree(settings.security_folder)
    return settings.security_folder / PUBLIC_KEYS_FILE


def with_other_public_keys(settings: Settings) -> Path:
    file = settings.security_folder / PUBLIC_KEYS_FILE
    listed = json.loads(file.read_bytes())
    key = listed["keys"][0]["x"]
    listed["keys"][0]["x"] = key[:-2] + ("AA" if key[-2:] != "AA" else "BA")
    file.write_text(json.dumps(listed))
    return file


def with_damaged_public_keys(settings: Settings) -> Path:
    file = settings.security_folder / PUBLIC_KEYS_FILE
    file.write_bytes(b"\xff" + file.read_bytes())
    return file


def without_private_keys(settings: Settings) -> Path:
    file = settings.data_dir / SIGNING_KEYS_FILE
    file.unlink()
    return file


def with_a_folder_for_public_keys(settings: Settings) -> Path:
    file = without_public_keys(settings)
    file.mkdir()
    return file


def without_database(settings: Settings) -> Path:
    for file in settings.data_dir.glob("accounts.db*"):
        file.unlink()
    return settings.data_dir / "accounts.db"


def with_damaged_private_keys(settings: Settings) -> Path:
    file = settings.data_dir / SIGNING_KEYS_FILE
    file.write_bytes(file.read_bytes()[:-30])
    return file


@pytest.fixture
async def used(settings: AccountsSettings) -> AccountsSettings:
    """Accounts with a person, which are stopped."""
    made = set_up(settings, ["lamp", "webui"])
    async with running(settings, made.owner_link or "") as accounts:
        await accounts.owner()
    return settings


@pytest.mark.parametrize("lose", [without_public_keys, without_security_folder])
@pytest.mark.parametrize("has_mark", [True, False])
async def test_a_service_does_not_open_because_its_keys_are_missing(
    used: AccountsSettings, lose: Callable[[Settings], Path], has_mark: bool
) -> None:
    if has_mark:
        await start(used)
        for file in (used.signing_keys_file, *used.data_dir.glob("accounts.db*")):
            file.rename(file.with_name(f"other-{file.name}"))  # accounts has a data directory of its own
    file = lose(used)
    with pytest.raises(UsageError, match="shows that accounts exist; restore it from a backup") as refused:
        await start(used)
    assert str(refused.value).startswith(f"{file} is missing")
    assert any(fault.startswith(f"{file} is missing") for fault in faults_in(used))


@pytest.mark.nightly
@pytest.mark.parametrize(
    "harm",
    [
        without_public_keys,
        without_security_folder,
        with_damaged_public_keys,
        with_other_public_keys,
        with_a_folder_for_public_keys,
        without_database,
        without_private_keys,
        with_damaged_private_keys,
    ],
)
async def test_accounts_and_the_check_name_keys_that_are_missing_or_damaged(
    used: AccountsSettings, harm: Callable[[Settings], Path]
) -> None:
    assert list(faults_in(used)) == []
    file = harm(used)
    with pytest.raises(UsageError) as refused:
        async with running(used):
            pass
    assert str(file) in str(refused.value)
    assert any(str(file) in fault for fault in faults_in(used))


SIGNS = {
    "a mark of another service": lambda settings: settings.data_dir / "other.accounts",
    "the private keys": lambda settings: settings.signing_keys_file,
    "the token of a service": lambda settings: settings.security_folder / SERVICE_TOKENS_FOLDER / "lamp",
    "changes of the database": lambda settings: settings.data_dir / "accounts.db-wal",
    "an empty database with a stamp": lambda settings: settings.data_dir / "accounts.db",
}


@pytest.mark.parametrize("sign", SIGNS)
async def test_one_remaining_sign_of_accounts_is_enough(used: AccountsSettings, sign: str) -> None:
    without_public_keys(used)
    kept = SIGNS[sign](used)
    (used.data_dir / "other.accounts").write_text("seen")
    content = kept.read_bytes() if kept.suffix not in {".db", ".db-wal"} else b""
    for file in (*used.data_dir.glob("*.accounts"), *used.data_dir.glob("accounts*"), used.security_folder):
        shutil.rmtree(file) if file.is_dir() else file.unlink(missing_ok=True)
    kept.parent.mkdir(exist_ok=True, parents=True)
    kept.write_bytes(content or (b"" if kept.suffix == ".db" else b"a change"))
    if kept.suffix == ".db":
        kept.with_name("accounts.db.stamp").write_bytes(b"1")
    with pytest.raises(UsageError, match="accounts exist"):
        await start(used)
    assert any("accounts exist" in fault for fault in faults_in(used))
    kept.unlink()
    kept.with_name("accounts.db.stamp").unlink(missing_ok=True)
    await start(used)
    assert list(faults_in(used)) == []


async def test_a_lost_database_is_not_replaced_by_an_empty_one(used: AccountsSettings) -> None:
    file = without_database(used)
    for begin in (lambda: set_up(used, ["lamp", "webui"]), lambda: owner_link(used)):
        with pytest.raises(UsageError, match=r"accounts\.db is missing.*restore it from a backup"):
            begin()
        assert not file.exists(), "nothing stands in the way of the backup"
    used.signing_keys_file.unlink()
    with pytest.raises(UsageError, match=r"accounts\.db is missing"):
        set_up(used, ["lamp", "webui"])


async def test_a_database_without_anybody_is_a_lost_one(used: AccountsSettings) -> None:
    without_database(used)
    store = Store(used.database("accounts"))
    store.prepare()
    store.close()
    with pytest.raises(UsageError, match="has neither people nor tokens"):
        async with running(used):
            pass
    with pytest.raises(UsageError, match="has neither people nor tokens"):
        owner_link(used)
    assert any("has neither people nor tokens" in fault for fault in faults_in(used))


def test_the_check_names_a_token_that_is_missing(used: AccountsSettings) -> None:
    file = used.security_folder / SERVICE_TOKENS_FOLDER / "lamp"
    file.unlink()
    assert list(faults_in(used)) == [], "it may be read elsewhere"
    (used.data_dir / "lamp.accounts").write_text("seen")
    assert any(fault.startswith(f"{file} is missing") for fault in faults_in(used))


async def test_keys_that_were_lost_are_written_again_by_the_command_that_the_error_names(
    used: AccountsSettings,
) -> None:
    without_security_folder(used)
    set_up(used, ["lamp", "webui"])
    await start(used)
    async with running(used):
        assert list(faults_in(used)) == []


@pytest.mark.parametrize("content", [b"", b"\x00\xff", b"hnd_service_short"])
async def test_a_damaged_token_is_named_by_its_service_and_the_check(
    used: AccountsSettings, content: bytes
) -> None:
    file = used.security_folder / SERVICE_TOKENS_FOLDER / "lamp"
    file.write_bytes(content)
    access = ServiceAccess(used, "lamp")
    with pytest.raises(UsageError, match="is damaged: it holds no token") as refused:
        await access.headers()
    assert str(file) in str(refused.value)
    assert any(str(file) in fault for fault in faults_in(used))


async def test_a_token_that_accounts_does_not_know_is_named_with_its_file(
    accounts: Accounts, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = accounts.settings.security_folder / SERVICE_TOKENS_FOLDER / "webui"
    token = file.read_text().strip()
    file.write_text(token[:-1] + ("A" if token[-1] != "A" else "B"))
    access = ServiceAccess(accounts.settings, "webui")

    async def answered(*_: object, **__: object) -> dict[str, object]:
        answer = await accounts.call("POST", "/service-tokens", {}, token=file.read_text().strip())
        raise AccountsUnavailable(f"answered {answer.status_code}", answer.json())

    monkeypatch.setattr(access, "call", answered)
    with pytest.raises(AccountsUnavailable, match=r"not know the token of webui in .*service-tokens/webui"):
        await access.headers()
    assert any(str(file) in fault for fault in faults_in(accounts.settings))


def test_a_damaged_key_for_notifications_is_named_by_the_check(tmp_path: Path) -> None:
    (tmp_path / "lamp.notification-key").write_bytes(b"\xff\x00")
    (tmp_path / "other.notification-key").mkdir()
    checked = subprocess.run(
        [sys.executable, "-m", "handover_cell", "check", "--data-dir", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert checked.returncode == 1
    assert "lamp.notification-key is damaged: it holds no key; delete it" in checked.stdout
    assert "other.notification-key cannot be read: Is a directory" in checked.stdout
    assert not checked.stderr
