"""Downloads follow redirects within bounds, to addresses that the outbound policy allows."""

import asyncio
import gzip
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest

from handover.network.outbound_policy import OutboundPolicy
from handover_bpmn.notation.document import MAX_BYTES
from handover_processes.documents.downloads import MAX_URL, Downloader, DownloadFailed

FILE = b"<definitions/>"
BEYOND = OutboundPolicy.of("0.0.0.0", "")
HERE = OutboundPolicy.of("0.0.0.0", "127.0.0.1")


def answer(status: str, body: bytes = b"", *headers: str) -> bytes:
    lines = [f"HTTP/1.1 {status}", f"Content-Length: {len(body)}", *headers]
    return ("\r\n".join(lines) + "\r\n\r\n").encode() + body


@asynccontextmanager
async def web_server(respond: Callable[[str], bytes | None]) -> AsyncIterator[str]:
    """A server on loopback whose answer to a target is `respond(target)`; None: it never answers."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while head := await reader.readuntil(b"\r\n\r\n"):
                response = respond(head.split()[1].decode())
                if response is None:
                    await reader.read()
                    return
                writer.write(response)
        except asyncio.IncompleteReadError:
            return
        finally:
            writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with server:
        yield f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"


async def downloaded(
    respond: Callable[[str], bytes | None], target: str, policy: OutboundPolicy = HERE, timeout_s: float = 60
) -> bytes:
    downloader = Downloader(policy)
    async with web_server(respond) as base:
        try:
            return await downloader.download(base + target, timeout_s=timeout_s)
        finally:
            downloader.close()


async def test_a_file_is_loaded_with_its_query_and_after_redirects() -> None:
    targets: list[str] = []

    def respond(target: str) -> bytes:
        targets.append(target)
        if target.startswith("/new"):
            return answer("200 OK", gzip.compress(FILE), "Content-Encoding: gzip")
        return answer("302 Found", b"", "Location: ../new/überprüfen file.bpmn?v=2")

    assert await downloaded(respond, "/old/a.bpmn?v=1#part") == FILE
    assert targets == ["/old/a.bpmn?v=1", "/new/%C3%BCberpr%C3%BCfen%20file.bpmn?v=2"]


@pytest.mark.parametrize("location", ["file:///etc/passwd", "ftp://example.com/a", "//169.254.169.254/token"])
async def test_a_redirect_is_checked_like_the_first_address(location: str) -> None:
    with pytest.raises(DownloadFailed, match=r"http or https|metadata"):
        await downloaded(lambda _: answer("301 Moved", b"", f"Location: {location}"), "/")


async def test_redirects_are_bounded() -> None:
    with pytest.raises(DownloadFailed, match="redirected more than 3 times"):
        await downloaded(lambda _: answer("307 Temporary", b"", "Location: /"), "/")


async def test_an_address_that_the_policy_refuses_is_not_connected_to() -> None:
    asked: list[str] = []

    def respond(target: str) -> bytes:
        asked.append(target)
        return answer("200 OK", FILE)

    with pytest.raises(DownloadFailed, match="HANDOVER_OUTBOUND_ALLOW"):
        await downloaded(respond, "/", BEYOND)
    assert not asked
    assert await downloaded(respond, "/") == FILE


@pytest.mark.parametrize(
    ("respond", "why"),
    [
        (lambda _: answer("404 Not Found", b"no"), "status 404"),
        (lambda _: answer("200 OK", b"x" * (MAX_BYTES + 1)), f"more than {MAX_BYTES} bytes"),
        (
            lambda _: answer("200 OK", gzip.compress(b" " * (MAX_BYTES + 1)), "Content-Encoding: gzip"),
            f"more than {MAX_BYTES} bytes",
        ),
        (lambda _: b"SSH-2.0-OpenSSH\r\n\r\n", "cannot be loaded"),
        (lambda _: answer("200 OK", FILE, "Content-Encoding: br"), "cannot be loaded"),
    ],
    ids=["status", "size", "bomb", "no http", "coding"],
)
async def test_an_invalid_answer_is_named(respond: Callable[[str], bytes], why: str) -> None:
    with pytest.raises(DownloadFailed, match=why):
        await downloaded(respond, "/")


async def test_a_server_that_does_not_answer_is_given_up() -> None:
    with pytest.raises(DownloadFailed, match=r"within 0\.2 s"):
        await downloaded(lambda _: None, "/", timeout_s=0.2)


@pytest.mark.parametrize(
    "url",
    ["http://", "http://[::1", "http://a:b/", "http://a:99999/", "http://exa mple/",
     "http://" + "ä" * 70 + ".de/", "mailto:a@example.com", "http://a\r\nHost: b/",
     "http://" + "a" * MAX_URL],
)  # fmt: skip
async def test_a_malformed_address_is_named(url: str) -> None:
    with pytest.raises(DownloadFailed):
        await Downloader(HERE).download(url, timeout_s=60)
