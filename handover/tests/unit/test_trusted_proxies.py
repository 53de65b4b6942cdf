"""Behind a proxy, the client's address and scheme come from its headers, and from those of no one else."""

import httpx
import pytest
from fastapi import FastAPI, Request

from handover.errors import UsageError
from handover.serving.server import behind_proxies
from handover.settings import Settings

FORWARDED = {"X-Forwarded-For": "192.0.2.7, 203.0.113.9", "X-Forwarded-Proto": "https"}


async def seen(proxies: str, peer: str, headers: dict[str, str]) -> tuple[str, str]:
    """Return the address and the scheme of a request as the application sees them."""
    app = FastAPI()

    @app.get("/")
    async def show(request: Request) -> list[str]:
        assert request.client is not None
        return [request.client.host, request.url.scheme]

    behind = behind_proxies(app, Settings.load(trusted_proxies=proxies))
    transport = httpx.ASGITransport(behind, client=(peer, 1234))
    async with httpx.AsyncClient(transport=transport, base_url="http://cell") as client:
        address, scheme = (await client.get("/", headers=headers)).json()
        return address, scheme


@pytest.mark.parametrize("proxies", ["127.0.0.1", "127.0.0.0/8,10.0.3.0/24"])
async def test_a_trusted_proxy_names_the_client_that_it_saw(proxies: str) -> None:
    """The client itself may have sent the header; what the proxy added stands last."""
    assert await seen(proxies, "127.0.0.1", FORWARDED) == ("203.0.113.9", "https")


async def test_a_chain_of_trusted_proxies_names_the_first_that_is_not_trusted() -> None:
    chain = {"X-Forwarded-For": "192.0.2.7, 203.0.113.9, 10.0.3.4"}
    assert (await seen("127.0.0.1,10.0.3.0/24", "127.0.0.1", chain))[0] == "203.0.113.9"


@pytest.mark.parametrize(
    ("proxies", "peer"), [("", "127.0.0.1"), ("10.0.3.4", "127.0.0.1"), ("::1", "10.0.3.4")]
)
async def test_the_headers_of_others_do_not_count(proxies: str, peer: str) -> None:
    assert await seen(proxies, peer, FORWARDED) == (peer, "http")


@pytest.mark.parametrize("proxies", ["*", "proxy.example", "10.0.3.4/24"])
def test_a_name_or_everybody_is_no_proxy(proxies: str) -> None:
    with pytest.raises(UsageError, match="is no address or network"):
        Settings.load(trusted_proxies=proxies)
