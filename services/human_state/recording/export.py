"""A recording as a FHIR Bundle, made in a process of its own: its cost grows with the recording."""

import io
import json
from pathlib import Path
from typing import Final

from handover.errors import HandoverError, Problem
from handover.offload import Offload
from services.human_state.exchange.fhir import session_bundle
from services.human_state.exchange.mcap import read_stream
from services.human_state.formats.errors import ExchangeError
from services.human_state.recording.archive import Archive
from services.human_state.storage.store import RecordingRow

MAX_MESSAGES: Final = 200_000
MAX_BYTES: Final = 64 * 2**20
TIMEOUT_S: Final = 300.0


class BundleExport:
    """Makes one Bundle at a time."""

    def __init__(self, folder: Path, key: bytes | None) -> None:
        self._folder = folder
        self._key = key
        self._offload = Offload(timeout_s=TIMEOUT_S)

    async def bundle(self, row: RecordingRow, session: str, at_s: float) -> bytes:
        """Return the Bundle of a recording that has ended as JSON. Raises `Problem`."""
        if (row.messages or 0) > MAX_MESSAGES or (row.size or 0) > MAX_BYTES:
            raise Problem(
                413,
                "Too long",
                f"the recording has {row.messages:,} messages and {row.size:,} bytes; a Bundle is made of at "
                f"most {MAX_MESSAGES:,} and {MAX_BYTES:,}. Download the MCAP file, and export a part of it",
            )
        try:
            return await self._offload.run(
                bundle_json, self._folder, self._key, row.id, row.subject, session, at_s
            )
        except (HandoverError, ExchangeError, OSError) as error:
            raise Problem(409, "No Bundle", f"the recording cannot be exported: {error}") from None


def bundle_json(  # noqa: PLR0917 - arguments of a process
    folder: Path, key: bytes | None, name: str, subject: str, session: str, at_s: float
) -> bytes:
    """Return the Bundle as JSON. Raises `SealError`, `ExchangeError` and `OSError`."""
    file = io.BytesIO(b"".join(Archive(folder, key).read(name)))
    bundle, _ = session_bundle(read_stream(file, name), subject, session, at_s)
    return json.dumps(bundle, allow_nan=False).encode()
