"""The write-ahead log is read here by what docs/reference/write-ahead-log.md says, and by that alone."""

import json
import struct
from pathlib import Path
from zlib import crc32

from services.context_broker.storage.entries import EntityRow, Entries
from services.context_broker.storage.records import encoded
from services.context_broker.storage.write_ahead_log import WriteAheadLog

DATABASE, OPENING = b"database", b"opening1"


def payload(sector: bytes, seed: int, attempt: int | None, index: int) -> bytes:
    """Return the payload of a sector whose checksum and index are right."""
    content, (number, place), (checksum,) = (
        sector[:502],
        struct.unpack_from("<IH", sector, 502),
        struct.unpack_from("<I", sector, 508),
    )
    assert crc32(sector[:508], seed) == checksum
    assert place == index
    assert attempt in {None, number}
    return content


def frame(content: bytes, at: int) -> tuple[int, bytes]:
    """Return number and record of the frame at an offset."""
    seed = crc32(OPENING)
    (attempt,) = struct.unpack_from("<I", content, at + 502)
    first = payload(content[at : at + 512], seed, attempt, 0)
    magic, number, length = struct.unpack_from("<4sQI", first)
    assert magic == b"HFRM"
    read = first
    for index in range(1, -(-(16 + length) // 502)):
        start = at + 512 * index
        read += payload(content[start : start + 512], seed, attempt, index)
    return number, read[16 : 16 + length]


def test_the_documented_format_is_enough_to_read_the_log(tmp_path: Path) -> None:
    log = WriteAheadLog(tmp_path / "broker.db")
    log.begin(DATABASE, OPENING)
    short = encoded(Entries(entities={7: EntityRow("tenant", "urn:x:1", b'{"a":1}')}))
    long = encoded(Entries(entities={8: EntityRow("", "urn:x:2", b'"' + b"x" * 9000 + b'"')}))
    log.append(short)
    log.append(long)
    log.close()
    content = (tmp_path / "broker.log-1").read_bytes()
    assert len(content) == len((tmp_path / "broker.log-2").read_bytes()) == 2 * 1024 * 1024
    stamp = struct.unpack_from("<8s8s8sB", payload(content[:512], 0, 0, 65535))
    assert stamp == (b"HOVRLOG1", DATABASE, OPENING, 0)
    assert frame(content, 4096) == (1, short)
    assert frame(content, 2 * 4096) == (2, long)
    line, _, bodies = frame(content, 4096)[1].partition(b"\n")
    assert json.loads(line)["entities"] == [[7, "tenant", "urn:x:1", 7]]
    assert bodies == b'{"a":1}'
