"""The headers of a request: media types, @context, preferences (clauses 6.3.4 to 6.3.6).

Pure functions of header values, cached because clients repeat them.
"""

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

from handover_broker.model.problems import bad_request_data, invalid_request
from handover_broker.model.validation import shown

JSON: Final = "application/json"
JSON_LD: Final = "application/ld+json"
GEO_JSON: Final = "application/geo+json"
MERGE_PATCH: Final = "application/merge-patch+json"
PLAIN: Final = (JSON, JSON_LD)
"""Media types of every operation, in the order of preference if the client has none."""
WITH_GEO_JSON: Final = (JSON, JSON_LD, GEO_JSON)
"""Media types of operations that return entities (clause 6.3.15)."""

Version = tuple[int, int]
"""A version of NGSI-LD: major and minor number."""

_CONTEXT_LINK: Final = re.compile(
    r'<([^>]*)>(?=[^,<]*;\s*rel\s*=\s*"?http://www\.w3\.org/ns/json-ld#context"?)', re.IGNORECASE
)
_VERSION: Final = re.compile(r"([0-9]{1,3})\.([0-9]{1,3})(?:\.[0-9]{1,3})?")
_WEIGHT: Final = re.compile(r"(?:0(?:\.[0-9]{0,3})?|1(?:\.0{0,3})?)")


@lru_cache(maxsize=1024)
def accepted(header: bytes, offered: Sequence[str] = PLAIN) -> str | None:
    """Return the preferred media type of `offered` by an Accept header; None if it accepts none.

    The most specific range that matches a type gives its weight (RFC 9110, clause 12.5.1), so a weight of 0
    excludes a type even if `*/*` is accepted. An invalid weight counts as 0.
    """
    weights: dict[str, float] = {}
    for part in header.decode("latin-1").split(","):
        media_range, *options = (piece.strip().lower() for piece in part.split(";"))
        weights[media_range] = next(
            (_weight(option[2:]) for option in options if option.startswith("q=")), 1.0
        )
    best, chosen = 0.0, None
    for media_type in offered:
        ranges = (media_type, f"{media_type.partition('/')[0]}/*", "*/*")
        weight = next((weights[candidate] for candidate in ranges if candidate in weights), 0.0)
        if weight > best:
            best, chosen = weight, media_type
    return chosen


@lru_cache(maxsize=1024)
def context_link(header: bytes) -> str | None:
    """Return the URL of the @context in a Link header; raise a problem if there are several."""
    urls: list[str] = _CONTEXT_LINK.findall(header.decode("latin-1"))
    if len(urls) > 1:
        raise bad_request_data("the Link header names more than one @context; put them into one document")
    return urls[0] if urls else None


@lru_cache(maxsize=1024)
def preferences(header: bytes) -> dict[str, str]:
    """Return the preferences of a Prefer header by name, in lower case (RFC 7240)."""
    preferred: dict[str, str] = {}
    for part in header.decode("latin-1").split(","):
        name, _, value = part.partition(";")[0].partition("=")
        preferred.setdefault(name.strip().lower(), value.strip().strip('"'))
    return preferred


def preferred_version(header: bytes) -> Version | None:
    """Return the version of `Prefer: ngsi-ld=<version>`, None if there is none."""
    wanted = preferences(header).get("ngsi-ld")
    if wanted is None:
        return None
    version = version_of(wanted)
    if version is None:
        raise invalid_request(f"Prefer: ngsi-ld is a version such as 1.6, not {shown(wanted)}")
    return version


def version_of(text: str) -> Version | None:
    """Return the version of a text such as `1.6` or `1.6.1`, None if it is not one."""
    match = _VERSION.fullmatch(text)
    return None if match is None else (int(match[1]), int(match[2]))


def _weight(text: str) -> float:
    return float(text) if _WEIGHT.fullmatch(text) else 1.0
