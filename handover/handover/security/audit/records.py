"""Records of an audit log as values: what each has, which are read, and what their chain says."""

import hashlib
import json
from dataclasses import dataclass
from typing import Any, Final

GENESIS: Final = "0" * 64
"""The hash before the first record."""
INTENDED: Final = "intended"
"""The outcome in a record that is written before its act."""


@dataclass(frozen=True, slots=True)
class AuditRecord:
    """One record. `text` is None where there was none, or where it was deleted."""

    seq: int
    at_ms: int
    subject: str
    action: str
    resource: str
    outcome: str
    method: str
    text_hash: str
    previous_hash: str
    hash: str
    text: str | None = None
    intent: int | None = None
    """The number of the intent whose outcome this is."""
    ended_by: int | None = None
    """Of an intent, the number of the record with its outcome; None where there is none."""


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of a check: how many records are intact, and the first fault."""

    records: int
    head: str
    fault: str | None = None


@dataclass(frozen=True, slots=True)
class AuditFilter:
    """Which records are read; None stands for all. `action` and `resource` are parts of the values.

    `about` is a whole resource.
    """

    subject: str | None = None
    action: str | None = None
    resource: str | None = None
    outcome: str | None = None
    since_ms: int | None = None
    until_ms: int | None = None
    about: str | None = None


def record_hash(values: dict[str, Any]) -> str:
    """Return the hash of a record: SHA-256 of its fields, except the hash, as JSON with sorted names.

    A record that is no outcome of an intent has the hash that it had before logs had intents.
    """
    content = {name: value for name, value in values.items() if name != "hash"}
    if content.get("intent", 0) is None:
        del content["intent"]
    return hashlib.sha256(
        json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
    ).hexdigest()


def text_hash(salt: str, text: str) -> str:
    """Return the hash by which a record names its text."""
    return hashlib.sha256(f"{salt}\n{text}".encode()).hexdigest()


def fault_of(
    record: dict[str, Any], expected: int, previous: str, salt: str | None, text: str | None
) -> str | None:
    """Return what is wrong with a record that follows the record with the hash `previous`; None if intact."""
    seq = record["seq"]
    if seq != expected:
        return f"record {expected} is missing"
    if record["previous_hash"] != previous:
        return f"record {seq} does not follow record {seq - 1}"
    if record["hash"] != record_hash(record):
        return f"record {seq} was changed"
    if text is not None and text_hash(salt or "", text) != record["text_hash"]:
        return f"the text of record {seq} was changed"
    return None
