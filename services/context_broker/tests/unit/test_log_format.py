"""The write-ahead log is read here by what docs/reference/write-ahead-log.md says, and by that alone."""

import json
import re
import struct
from pathlib import Path
from typing import Any
from zlib import crc32

from handover_broker.model.entity import Entity
from handover_broker.storage.entries import (
    DocumentKind,
    EntityRow,
    Entries,
    PendingNotification,
)
from handover_broker.storage.history_archive import HistoryRow, TemporalOnlyRow
from handover_broker.storage.write_ahead_log.log import WriteAheadLog
from handover_broker.storage.write_ahead_log.records import encode
from handover_broker.temporal.history import RowContent, TemporalOnlyEntity
from tests.kit.paths import REPOSITORY

PAGE = REPOSITORY / "docs" / "reference" / "write-ahead-log.md"
DATABASE_ID, LOG_ID = b"database", b"log id 1"
EVERYTHING = Entries(
    entities={7: EntityRow("tenant", "urn:x:1", b'{"a":1}')},
    documents={
        (DocumentKind.CONTEXT, "tenant", "urn:c"): b"{}",
        (DocumentKind.SUBSCRIPTION, "", "urn:s"): None,
    },
    pending=[PendingNotification("tenant", "urn:s", "urn:x:1", 3.5, b"[1]", 4, b'{"h":1}')],
    settled=[2, 3],
    history=[HistoryRow(7, 1_000, None, 2.5, 0, b"change")],
    cleared=[(7, 900)],
    temporal_only={8: TemporalOnlyRow("", "urn:x:2", None)},
)


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
    """Return number and content of the frame at an offset."""
    seed = crc32(LOG_ID)
    (attempt,) = struct.unpack_from("<I", content, at + 502)
    first = payload(content[at : at + 512], seed, attempt, 0)
    magic, number, length = struct.unpack_from("<4sQI", first)
    assert magic == b"HFRM"
    read = first
    for index in range(1, -(-(16 + length) // 502)):
        start = at + 512 * index
        read += payload(content[start : start + 512], seed, attempt, index)
    return number, read[16 : 16 + length]


def records(content: bytes) -> dict[str, list[dict[str, Any]]]:
    """Return the records of a frame by type, each with its bodies in place of their sizes."""
    line, _, bodies = content.partition(b"\n")
    found: dict[str, list[dict[str, Any]]] = json.loads(line)
    for rows in found.values():
        for row in rows:
            for name in [name for name in row if name.endswith("_size")]:
                size = row.pop(name)
                row[name.removesuffix("_size")] = None if size is None else bodies[:size]
                bodies = bodies[size or 0 :]
    assert not bodies
    return found


def documented(section: str) -> dict[str, list[str]]:
    """Return the names in the second column of a table of the page, by the first column."""
    text = PAGE.read_text().partition(f"## {section}\n")[2].partition("\n## ")[0]
    rows = [line.split("|") for line in text.splitlines() if line.startswith("| `")]
    return {row[1].strip(" `"): re.findall(r"`(\w+)`", row[2]) for row in rows}


def test_the_documented_format_is_enough_to_read_the_log(tmp_path: Path) -> None:
    log = WriteAheadLog(tmp_path / "broker.db")
    log.begin(DATABASE_ID, LOG_ID)
    short = encode(EVERYTHING)
    long = encode(Entries(entities={8: EntityRow("", "urn:x:2", b'"' + b"x" * 9000 + b'"')}))
    log.append(short)
    log.append(long)
    log.close()
    content = (tmp_path / "broker.log-1").read_bytes()
    assert len(content) == len((tmp_path / "broker.log-2").read_bytes()) == 2 * 1024 * 1024
    header = struct.unpack_from("<8s8s8sB", payload(content[:512], 0, 0, 65535))
    assert header == (b"HOVRLOG1", DATABASE_ID, LOG_ID, 0)
    assert frame(content, 4096) == (1, short)
    assert frame(content, 2 * 4096) == (2, long)
    assert records(short) == {
        "entity/1": [{"seq": 7, "tenant": "tenant", "id": "urn:x:1", "body": b'{"a":1}'}],
        "history/1": [
            {
                "entity": 7,
                "seq": 1_000,
                "observed_from": None,
                "observed_to": 2.5,
                "rewritten": 0,
                "body": b"change",
            }
        ],
        "document/1": [
            {"kind": "context", "tenant": "tenant", "id": "urn:c", "body": b"{}"},
            {"kind": "subscription", "tenant": "", "id": "urn:s", "body": None},
        ],
        "notification/1": [
            {
                "seq": 4,
                "tenant": "tenant",
                "subscription": "urn:s",
                "entity": "urn:x:1",
                "at": 3.5,
                "body": b"[1]",
                "headers": b'{"h":1}',
            }
        ],
        "notification_done/1": [{"seq": 2}, {"seq": 3}],
        "history_cleared/1": [{"entity": 7, "before": 900}],
        "temporal_only_entity/1": [{"seq": 8, "tenant": "", "id": "urn:x:2", "body": None}],
    }


def test_each_type_of_record_is_documented_with_its_fields() -> None:
    written = json.loads(encode(EVERYTHING).partition(b"\n")[0])
    assert {name: list(rows[0]) for name, rows in written.items()} == documented("Records")


def test_the_members_of_the_bodies_are_documented() -> None:
    at = "2026-01-01T00:00:00Z"
    change = RowContent(
        {"urn:a": [{"type": "Property", "value": 1}]}, {"urn:b": [("Property", None)]}, ["/a"]
    )
    written = {
        "entity/1": Entity("urn:x", ("urn:t",), {}, at, at, 1, former_types=("urn:s",)).stored(),
        "history/1": change.stored(),
        "temporal_only_entity/1": TemporalOnlyEntity(
            ("urn:t",), (), at, at, None, former_types=("urn:s",)
        ).stored(),
    }
    bodies = documented("Bodies")
    assert {name: list(json.loads(body)) for name, body in written.items()} == {
        name: bodies[name] for name in written
    }
