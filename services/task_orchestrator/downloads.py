"""Downloads: BPMN files from the addresses in entities of other systems, with bounds.

Only http and https are followed, also after a redirect. The size, the number of redirects and the whole time
are limited, however slowly the server sends.
"""

import asyncio
from urllib.parse import urlsplit

import httpx

from handover.errors import HandoverError
from handover.messages import message
from services.task_orchestrator.notation.document import MAX_BYTES

SCHEMES = frozenset({"http", "https"})
MAX_REDIRECTS = 3
MAX_URL = 2000
TIMEOUT_S = 10.0


class DownloadFailed(HandoverError):
    """The file was not received; the message says why."""


async def download(url: str, *, timeout_s: float = TIMEOUT_S) -> bytes:
    """Return the file at `url`; raise `DownloadFailed`."""
    if len(url) > MAX_URL:
        raise DownloadFailed(
            message("offer.url_too_long", "the address has more than {limit} characters", limit=MAX_URL)
        )
    try:
        async with asyncio.timeout(timeout_s):
            return await _follow(url)
    except TimeoutError:
        raise DownloadFailed(
            message(
                "offer.download_slow",
                "{url} did not send the file within {seconds} s",
                url=url,
                seconds=f"{timeout_s:g}",
            )
        ) from None
    except (httpx.HTTPError, httpx.InvalidURL, ValueError, OSError) as error:
        reason = str(error) or type(error).__name__
        raise DownloadFailed(
            message("offer.download_failed", "{url} cannot be loaded: {why}", url=url, why=reason)
        ) from None


async def _follow(url: str) -> bytes:
    async with httpx.AsyncClient(trust_env=False, timeout=None, follow_redirects=False) as client:  # noqa: S113
        for _ in range(MAX_REDIRECTS + 1):
            _require_scheme(url)
            async with client.stream("GET", url) as answer:
                if answer.is_redirect and "location" in answer.headers:
                    url = str(answer.url.join(answer.headers["location"]))
                    continue
                if answer.status_code != httpx.codes.OK:
                    raise DownloadFailed(
                        message(
                            "offer.download_status",
                            "{url} answers with the status {status}",
                            url=url,
                            status=answer.status_code,
                        )
                    )
                return await _received(answer, url)
    raise DownloadFailed(
        message(
            "offer.redirects", "{url} is redirected more than {limit} times", url=url, limit=MAX_REDIRECTS
        )
    )


async def _received(answer: httpx.Response, url: str) -> bytes:
    body = bytearray()
    async for chunk in answer.aiter_bytes(64 * 1024):
        body += chunk
        if len(body) > MAX_BYTES:
            raise DownloadFailed(
                message(
                    "offer.download_too_large",
                    "{url} has more than {limit} bytes, the limit of a BPMN file",
                    url=url,
                    limit=MAX_BYTES,
                )
            )
    return bytes(body)


def _require_scheme(url: str) -> None:
    scheme = urlsplit(url).scheme.lower()
    if scheme not in SCHEMES:
        raise DownloadFailed(
            message(
                "offer.scheme",
                'bpmn is neither a BPMN file nor an http or https address: "{start}"',
                start=url[:100],
            )
        )
