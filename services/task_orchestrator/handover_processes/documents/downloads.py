"""Downloads: BPMN files from the addresses in entities of other systems, with bounds.

Only http and https are followed, also after a redirect, and only to addresses that the outbound policy
allows. The size, the number of redirects and the whole time are limited, however slowly the server sends.
"""

import asyncio
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from urllib.parse import quote, urljoin, urlsplit, urlunsplit

from handover.errors import TranslatedError
from handover.network.http_client import (
    BodyReadingHttpClient,
    HttpResponse,
    ResponseTimeout,
    ResponseTooLarge,
    SendError,
)
from handover.network.outbound_policy import OutboundPolicy
from handover_bpmn.notation.document import MAX_BYTES

SCHEMES = frozenset({"http", "https"})
MAX_REDIRECTS = 3
REDIRECTS = frozenset(
    {
        HTTPStatus.MOVED_PERMANENTLY,
        HTTPStatus.FOUND,
        HTTPStatus.SEE_OTHER,
        HTTPStatus.TEMPORARY_REDIRECT,
        HTTPStatus.PERMANENT_REDIRECT,
    }
)
MAX_URL = 2000
TIMEOUT_S = 10.0
PATH_CHARACTERS = "/%:@!$&'()*+,;=~"
"""Characters of paths that are sent as they are (RFC 3986, 3.3)."""
HEADERS = (("Accept", "*/*"), ("Accept-Encoding", "gzip, deflate"))


class DownloadFailed(TranslatedError):
    """The file was not received; the message says why."""


class Downloader:
    """Loads files from addresses that `policy` allows."""

    def __init__(self, policy: OutboundPolicy, ca_files: Sequence[Path] = ()) -> None:
        self._http = BodyReadingHttpClient(policy, ca_files, max_response_bytes=MAX_BYTES)

    def close(self) -> None:
        """Close the idle connections."""
        self._http.close()

    async def download(self, url: str, *, timeout_s: float = TIMEOUT_S) -> bytes:
        """Return the file at `url`; raise `DownloadFailed`."""
        if len(url) > MAX_URL:
            raise DownloadFailed.translated(
                "offer.url_too_long", "the address has more than {limit} characters", limit=MAX_URL
            )
        try:
            async with asyncio.timeout(timeout_s):
                return await self._follow(url, timeout_s)
        except TimeoutError:
            raise _slow(url, timeout_s) from None

    async def _follow(self, url: str, timeout_s: float) -> bytes:
        for _ in range(MAX_REDIRECTS + 1):
            answer = await self._get(url, timeout_s)
            location = answer.headers.get("location")
            if answer.status in REDIRECTS and location is not None:
                url = urljoin(url, location.encode("latin-1").decode("utf-8", "replace"))
                continue
            if answer.status != HTTPStatus.OK:
                raise DownloadFailed.translated(
                    "offer.download_status",
                    "{url} answers with the status {status}",
                    url=url,
                    status=answer.status,
                )
            return answer.body
        raise DownloadFailed.translated(
            "offer.redirects", "{url} is redirected more than {limit} times", url=url, limit=MAX_REDIRECTS
        )

    async def _get(self, url: str, timeout_s: float) -> HttpResponse:
        with _reported(url, timeout_s):
            return await self._http.request("GET", _as_ascii(url), HEADERS, b"", timeout_s)


@contextmanager
def _reported(url: str, timeout_s: float) -> Iterator[None]:
    """Raise the errors of the client as `DownloadFailed`."""
    try:
        yield
    except ResponseTimeout:
        raise _slow(url, timeout_s) from None
    except ResponseTooLarge:
        raise DownloadFailed.translated(
            "offer.download_too_large",
            "{url} has more than {limit} bytes, the limit of a BPMN file",
            url=url,
            limit=MAX_BYTES,
        ) from None
    except (SendError, ValueError, OSError) as error:
        reason = str(error) or type(error).__name__
        raise DownloadFailed.translated(
            "offer.download_failed", "{url} cannot be loaded: {why}", url=url, why=reason
        ) from None


def _slow(url: str, timeout_s: float) -> DownloadFailed:
    return DownloadFailed.translated(
        "offer.download_slow",
        "{url} did not send the file within {seconds} s",
        url=url,
        seconds=f"{timeout_s:g}",
    )


def _as_ascii(url: str) -> str:
    """Return `url` as it is sent.

    Raises `DownloadFailed` for another scheme, `ValueError` for an address that cannot be read.
    """
    parts = urlsplit(url)
    if parts.scheme.lower() not in SCHEMES:
        raise DownloadFailed.translated(
            "offer.scheme",
            'bpmn is neither a BPMN file nor an http or https address: "{start}"',
            start=url[:100],
        )
    if not parts.hostname:
        raise ValueError("the address has no host")
    host = parts.hostname if ":" in parts.hostname else parts.hostname.encode("idna").decode()
    literal = f"[{host}]" if ":" in host else host
    return urlunsplit(
        (
            parts.scheme,
            literal if parts.port is None else f"{literal}:{parts.port}",
            quote(parts.path, safe=PATH_CHARACTERS),
            quote(parts.query, safe=PATH_CHARACTERS + "?"),
            "",
        )
    )
