"""The origin check: a server's own page may act, another site may not, a foreign name is refused."""

import httpx
import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from handover.http.origin_guard import OriginGuard, OriginPolicy, is_known_host, is_same_origin
from handover.settings import Settings


async def answer(request: Request) -> Response:
    return PlainTextResponse("in")


METHODS = ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"]


@pytest.fixture
def browser() -> httpx.AsyncClient:
    inside = Starlette(routes=[Route("/{rest:path}", answer, methods=METHODS)])
    return httpx.AsyncClient(
        transport=httpx.ASGITransport(
            OriginGuard(inside, OriginPolicy(["panel.hall-3.example"], ["https://wiki.example"]))
        ),
        base_url="http://127.0.0.1:54400",
    )


@pytest.mark.parametrize(
    "host",
    [
        "127.0.0.1:54400",
        "localhost:54400",
        "localhost",
        "[::1]:54400",
        "192.168.7.20:54400",
        "panel.hall-3.example",
        "PANEL.hall-3.example:80",
    ],
)
async def test_an_address_and_a_known_name_lead_in(browser: httpx.AsyncClient, host: str) -> None:
    assert (await browser.get("/", headers={"Host": host})).status_code == 200


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:54400", "127.0.0.1.evil.example", "localhost.evil.example", "", "a b"],
)
async def test_a_foreign_name_leads_nowhere_and_the_way_out_is_said(
    browser: httpx.AsyncClient, host: str
) -> None:
    refused = await browser.get("/api/events", headers={"Host": host})
    assert refused.status_code == 403
    assert refused.headers["content-type"] == "application/problem+json"
    assert "HANDOVER_ALLOWED_HOSTS" in refused.json()["detail"]


@pytest.mark.parametrize("path", ["/healthz", "/readyz", "/metrics", "/context.jsonld"])
async def test_platforms_ask_by_any_name(browser: httpx.AsyncClient, path: str) -> None:
    assert (await browser.get(path, headers={"Host": "webui:54400"})).status_code == 200
    assert (await browser.post(path, headers={"Host": "webui:54400"})).status_code == 403


@pytest.mark.parametrize("method", ["GET", "HEAD", "OPTIONS", "POST", "PUT", "PATCH", "DELETE"])
@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:8080", "http://localhost:54400", "file://"]
)
async def test_a_page_of_another_site_changes_nothing(
    browser: httpx.AsyncClient, method: str, origin: str
) -> None:
    refused = await browser.request(method, "/api/operator", headers={"Origin": origin})
    assert refused.status_code == 403
    assert method == "HEAD" or origin in refused.json()["detail"]


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
async def test_a_browser_that_hides_the_origin_still_says_that_it_is_another_site(
    browser: httpx.AsyncClient, site: str
) -> None:
    assert (await browser.post("/api/operator", headers={"Sec-Fetch-Site": site})).status_code == 403


async def test_our_own_page_and_programs_may_act(browser: httpx.AsyncClient) -> None:
    ours = await browser.post("/api/operator", headers={"Origin": "http://127.0.0.1:54400"})
    assert ours.status_code == 200
    assert (await browser.post("/api/operator")).status_code == 200


async def test_behind_tls_our_own_page_is_ours(browser: httpx.AsyncClient) -> None:
    headers = {"Host": "panel.hall-3.example", "Origin": "https://panel.hall-3.example"}
    assert (await browser.post("/api/operator", headers=headers)).status_code == 200


async def test_a_listed_origin_may_act(browser: httpx.AsyncClient) -> None:
    headers = {"Origin": "https://wiki.example", "Sec-Fetch-Site": "cross-site"}
    assert (await browser.post("/api/operator", headers=headers)).status_code == 200


async def test_a_link_from_another_site_leads_in_and_an_image_does_not(browser: httpx.AsyncClient) -> None:
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert (await browser.get("/", headers=link)).status_code == 200
    assert (await browser.post("/", headers=link)).status_code == 403
    image = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}
    assert (await browser.get("/api/events", headers=image)).status_code == 403


async def test_a_name_that_was_refused_stays_refused(browser: httpx.AsyncClient) -> None:
    for host, status in (
        ("127.0.0.1", 200),
        ("evil.example", 403),
        ("127.0.0.1", 200),
        ("evil.example", 403),
    ):
        assert (await browser.get("/api/events", headers={"Host": host})).status_code == status


def test_the_hosts_in_our_own_urls_are_known() -> None:
    settings = Settings.load(broker_url="http://Context-Broker:1026", allowed_hosts=("panel",))
    policy = OriginPolicy.of(settings, ["http://lamp:9100"])
    for host, known in (
        (b"context-broker:1026", True),
        (b"lamp", True),
        (b"panel:80", True),
        (b"w3id.org", False),
        (b"context-broker.evil.example", False),
    ):
        assert (policy.refusal("GET", "/", {b"host": host}) is None) is known, host


def test_very_many_hosts_are_not_remembered() -> None:
    policy = OriginPolicy()
    for number in range(5000):
        assert policy.refusal("GET", "/", {b"host": b"127.0.0.1:%d" % number}) is None
    assert len(policy._known) <= 1001


@pytest.mark.parametrize(
    ("origin", "host", "same"),
    [
        ("http://panel", "panel", True),
        ("http://panel:80", "panel", True),
        ("https://panel", "panel:443", True),
        ("http://panel", "panel:54400", False),
        ("http://[::1]:54400", "[::1]:54400", True),
        ("http://panel@evil:80", "panel", False),
        ("http://[panel", "panel", False),
    ],
)
def test_origins_are_compared_with_their_ports(origin: str, host: str, same: bool) -> None:
    assert is_same_origin(origin, host) is same


def test_a_name_that_merely_looks_like_an_address_is_none() -> None:
    assert not is_known_host("127.0.0.1.nip.example", [])
    assert not is_known_host("0x7f.1.example", [])
