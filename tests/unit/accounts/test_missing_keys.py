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
from handover.security.service_access import SERVICE_TOKENS_FOLDER, AccountsUnavailable, ServiceAccess
from handover.settings import SIGNING_KEYS_FILE, Settings
from services.accounts.check import faults_in
from services.accounts.set_up import set_up
from services.accounts.settings import AccountsSettings
from tests.unit.accounts.conftest import Accounts, running


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


@pytest.mark.parametrize(
    "harm",
    [
        without_public_keys,
        without_security_folder,
        with_damaged_public_keys,
        with_other_public_keys,
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
    checked = subprocess.run(
        [sys.executable, "-m", "handover.cli", "check", "--data-dir", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert checked.returncode == 1
    assert "lamp.notification-key is damaged: it holds no key; delete it" in checked.stdout
