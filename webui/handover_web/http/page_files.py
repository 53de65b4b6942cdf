"""The files of the built page in `webui/handover_web/page`.

Files under `assets/` have a hash in their names and are cached forever. A `.br` or `.gz` beside a file is
sent in its place to a browser that accepts the encoding. Any other address is a route of the page and gets
`index.html`.

What was found for an address is used for `FRESH_S` without looking at the disk, and short files are kept in
memory; requests for a range, and long files, are read from the disk.
"""

import asyncio
import os
import time
from dataclasses import dataclass
from email.utils import formatdate
from pathlib import Path, PurePosixPath
from typing import Final

from starlette.datastructures import Headers
from starlette.responses import FileResponse, HTMLResponse, Response

from handover.errors import Problem
from handover.messages import message

FOLDER: Final = Path(__file__).parent.parent / "page"
CACHE_FOREVER: Final = "public, max-age=31536000, immutable"
REVALIDATE: Final = "no-cache"
ENCODINGS: Final = (("br", ".br"), ("gzip", ".gz"))
FRESH_S: Final = 1.0
MAX_KEPT_FILE_BYTES: Final = 1024 * 1024
MAX_KEPT_BYTES: Final = 32 * 1024 * 1024
MAX_KEPT_ADDRESSES: Final = 1_000
MEDIA_TYPES: Final = {
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".txt": "text/plain; charset=utf-8",
    ".map": "application/json",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".webp": "image/webp",
    ".ico": "image/vnd.microsoft.icon",
    ".woff": "font/woff",
    ".woff2": "font/woff2",
    ".wasm": "application/wasm",
    ".stl": "model/stl",
    ".dae": "model/vnd.collada+xml",
    ".urdf": "application/xml",
    ".bpmn": "application/xml",
    ".webmanifest": "application/manifest+json",
}

NOT_BUILT: Final = """<!doctype html>
<html lang="en">
<head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Handover</title></head>
<body style="font: 20px/1.5 system-ui, sans-serif; max-width: 40em; margin: 4em auto; padding: 0 1em">
<h1>The page is not built yet</h1>
<p>The services are running, but the page is missing. Run <code>make setup</code> in the folder of Handover,
then reload this page.</p>
</body>
</html>
"""


@dataclass(frozen=True, slots=True)
class FoundFile:
    """A file to send; `encoding` is None for an uncompressed one."""

    path: Path
    name: str
    encoding: str | None
    status: os.stat_result
    content: bytes | None
    """None for one that is read from the disk."""

    @property
    def etag(self) -> str:
        """Return the entity tag: it differs for another version or encoding."""
        return f'"{self.status.st_mtime_ns:x}-{self.status.st_size:x}{self.encoding or ""}"'


class PageFiles:
    """The files of the built page in `folder`."""

    def __init__(self, folder: Path = FOLDER) -> None:
        self._folder = folder
        self._found: dict[tuple[str, frozenset[str]], tuple[float, FoundFile | None]] = {}
        self._kept: dict[Path, FoundFile] = {}

    @property
    def is_built(self) -> bool:
        """Whether the page has been built."""
        return (self._folder / "index.html").is_file()

    async def respond(self, address: str, headers: Headers) -> Response:
        """Return the file at `address` (a path without its leading slash), or `index.html` for a route.

        Raises `Problem` 404 for a missing file.
        """
        accepted = _accepted_encodings(headers.get("accept-encoding", ""))
        file = await self._look_up(address, accepted)
        if file is None:
            if address.startswith("assets/") or _media_type(address) is not None:
                raise Problem(
                    404,
                    "Not found",
                    message(
                        "page.no_such_file",
                        'the page has no file "{address}"; reload the page',
                        address=address,
                    ),
                )
            file = await self._look_up("index.html", accepted)
        if file is None:
            return HTMLResponse(NOT_BUILT, 503, {"Cache-Control": "no-store"})
        return _file_response(file, headers.get("if-none-match", ""), has_range="range" in headers)

    async def _look_up(self, address: str, accepted: frozenset[str]) -> FoundFile | None:
        now_s = time.monotonic()
        remembered = self._found.get((address, accepted))
        if remembered is not None and now_s < remembered[0]:
            return remembered[1]
        file = await asyncio.to_thread(self._find, address, accepted)
        if len(self._found) >= MAX_KEPT_ADDRESSES:
            self._found.clear()
        self._found[address, accepted] = now_s + FRESH_S, file
        return file

    def _find(self, address: str, accepted: frozenset[str]) -> FoundFile | None:
        name = address or "index.html"
        parts = PurePosixPath(name).parts
        if not parts or name.startswith("/") or any(part.startswith(".") for part in parts):
            return None
        if "\0" in name or "\\" in name:
            return None
        plain = self._folder.joinpath(*parts)
        for encoding, suffix in ENCODINGS:
            if encoding in accepted:
                compressed = plain.with_name(plain.name + suffix)
                if compressed.is_file() and plain.is_file():
                    return self._read(compressed, name, encoding)
        return self._read(plain, name, None) if plain.is_file() else None

    def _read(self, path: Path, name: str, encoding: str | None) -> FoundFile:
        """Return a file, from memory if it is the same version; called in threads."""
        status, kept = path.stat(), self._kept.get(path)
        if kept is not None and kept.etag == FoundFile(path, name, encoding, status, None).etag:
            return kept
        if status.st_size > MAX_KEPT_FILE_BYTES:
            return FoundFile(path, name, encoding, status, None)
        file = FoundFile(path, name, encoding, status, path.read_bytes())
        if (
            status.st_size + sum(kept_file.status.st_size for kept_file in list(self._kept.values()))
            > MAX_KEPT_BYTES
        ):
            self._kept.clear()
        self._kept[path] = file
        return file


def _file_response(file: FoundFile, etag: str, *, has_range: bool) -> Response:
    headers = {
        "Cache-Control": CACHE_FOREVER if file.name.startswith("assets/") else REVALIDATE,
        "ETag": file.etag,
        "Vary": "Accept-Encoding",
    }
    if file.etag in (tag.strip().removeprefix("W/") for tag in etag.split(",")):
        return Response(status_code=304, headers=headers)
    if file.encoding:
        headers["Content-Encoding"] = file.encoding
    media_type = _media_type(file.name) or "application/octet-stream"
    if file.content is None or has_range:
        return FileResponse(file.path, headers=headers, media_type=media_type, stat_result=file.status)
    headers["Accept-Ranges"] = "bytes"
    headers["Last-Modified"] = formatdate(file.status.st_mtime, usegmt=True)
    return Response(file.content, headers=headers, media_type=media_type)


def _media_type(name: str) -> str | None:
    """Return the media type of a file by its suffix, None without a known one."""
    return MEDIA_TYPES.get(PurePosixPath(name).suffix.lower())


def _accepted_encodings(header: str) -> frozenset[str]:
    """Return the encodings of `Accept-Encoding`, without those refused with `q=0`."""
    accepted = set()
    for part in header.split(","):
        encoding, _, quality = part.strip().partition(";")
        if quality.replace(" ", "") not in {"q=0", "q=0.0", "q=0.00", "q=0.000"}:
            accepted.add(encoding.strip().lower())
    return frozenset(accepted)
