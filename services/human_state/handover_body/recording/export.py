"""A recording as a FHIR Bundle or as XDF, made in a process of its own: its cost grows with the recording."""

import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from handover.errors import HandoverError, Problem
from handover.runtime.offload import Offload
from handover_body.exchange.fhir import session_bundle
from handover_body.exchange.mcap import read_stream
from handover_body.exchange.xdf import XdfWriter
from handover_body.formats.errors import ExchangeError
from handover_body.formats.json_messages import Recorded
from handover_body.recording.archive import Archive
from handover_body.storage.store import RecordingRow

MAX_MESSAGES: Final = 200_000
MAX_BYTES: Final = 64 * 2**20
TIMEOUT_S: Final = 300.0


class RecordingExport:
    """Makes one file at a time."""

    def __init__(self, folder: Path, key: bytes | None) -> None:
        self._folder = folder
        self._key = key
        self._offload = Offload(timeout_s=TIMEOUT_S)

    async def bundle(self, row: RecordingRow, session: str, at_s: float) -> bytes:
        """Return the Bundle of a recording that has ended as JSON. Raises `Problem`."""
        return await self._made(row, bundle_json, session, at_s)

    async def xdf(self, row: RecordingRow) -> bytes:
        """Return a recording that has ended as XDF 1.0. Raises `Problem`."""
        return await self._made(row, xdf_file)

    async def _made(self, row: RecordingRow, function: Callable[..., bytes], *arguments: Any) -> bytes:
        if (row.messages or 0) > MAX_MESSAGES or (row.size or 0) > MAX_BYTES:
            raise Problem(
                413,
                "Too long",
                f"the recording has {row.messages:,} messages and {row.size:,} bytes; this format has "
                f"at most {MAX_MESSAGES:,} and {MAX_BYTES:,}. Download the MCAP file",
            )
        try:
            made: bytes = await self._offload.run(
                function, self._folder, self._key, row.id, row.subject, *arguments
            )
        except (HandoverError, ExchangeError, OSError) as error:
            raise Problem(409, "No export", f"the recording cannot be exported: {error}") from None
        return made


def bundle_json(  # noqa: PLR0917 - arguments of a process
    folder: Path, key: bytes | None, name: str, subject: str, session: str, at_s: float
) -> bytes:
    """Return the Bundle as JSON. Raises `SealError`, `ExchangeError` and `OSError`."""
    bundle, _ = session_bundle(_recorded(folder, key, name), subject, session, at_s)
    return json.dumps(bundle, allow_nan=False).encode()


def xdf_file(folder: Path, key: bytes | None, name: str, subject: str) -> bytes:
    """Return the file. Raises `SealError`, `ExchangeError` and `OSError`."""
    file = io.BytesIO()
    with XdfWriter(file, subject) as writer:
        for item in _recorded(folder, key, name):
            writer.write(item)
    return file.getvalue()


def _recorded(folder: Path, key: bytes | None, name: str) -> Iterator[Recorded]:
    return read_stream(io.BytesIO(b"".join(Archive(folder, key).read(name))), name)
