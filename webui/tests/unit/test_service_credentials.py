"""The page server sends its token to our services, and to nobody else."""

from pathlib import Path

import httpx
import pytest

from handover.security.access_tokens import SigningKey, key_set
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.service_access import ServiceAccess
from handover.settings import Settings
from handover_web.service_credentials import ServiceCredentials

OURS = ["http://127.0.0.1:54200", "https://tool.example:54220"]
SCRIPT = "hnd_script_" + "a" * 43


def client(folder: Path, **given: str) -> httpx.AsyncClient:
    settings = Settings(data_dir=folder, _env_file=None, **given)

    def answer(request: httpx.Request) -> httpx.Response:
        return httpx.Response(200, text=request.headers.get("authorization", ""))

    credentials = ServiceCredentials(ServiceAccess(settings, "webui"), OURS)
    return httpx.AsyncClient(auth=credentials, transport=httpx.MockTransport(answer))


def set_up_accounts(folder: Path) -> None:
    (folder / "security").mkdir()
    (folder / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(SigningKey.generate()))


async def test_without_accounts_there_is_no_token(tmp_path: Path) -> None:
    (tmp_path / "security").mkdir()  # a component on another machine has no such folder
    async with client(tmp_path, service_token=SCRIPT) as http:
        assert (await http.get(OURS[0])).text == ""


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        (f"{OURS[0]}/processes", f"Bearer {SCRIPT}"),
        (f"{OURS[1]}/robots", f"Bearer {SCRIPT}"),
        ("http://127.0.0.1:54299/readyz", ""),
        ("https://tool.example/robots", ""),
        ("http://tool.example:54220/robots", ""),
        ("http://tool.example.evil.example:54220/", ""),
    ],
)
async def test_only_our_services_get_the_token(tmp_path: Path, url: str, expected: str) -> None:
    set_up_accounts(tmp_path)
    async with client(tmp_path, service_token=SCRIPT) as http:
        assert (await http.get(url)).text == expected


async def test_a_token_that_is_missing_is_a_failed_request(tmp_path: Path) -> None:
    set_up_accounts(tmp_path)
    async with client(tmp_path) as http:
        with pytest.raises(httpx.RequestError, match="no service token"):
            await http.get(OURS[0])
