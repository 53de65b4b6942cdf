"""Ids, times and names as NGSI-LD writes them, checked once at the door."""

import re
import time
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any

from handover.durations import parse_duration
from services.context_broker.model.problems import bad_request_data

MAX_ID_LENGTH = 2048
MAX_NAME_LENGTH = 512
MAX_TENANT_LENGTH = 128
MAX_TIME_LENGTH = 64

TENANT = re.compile(rf"[A-Za-z0-9_.\-]{{1,{MAX_TENANT_LENGTH}}}")

_INSIDE = "\u2234"
"""Begins the name of what belongs to a snapshot: no header can say it, so no asker can name it."""

_UNSEEN = (
    r"\u00ad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180e\u200b-\u200f\u2028-\u202f\u2060-\u206f"
    r"\u2800\u3164\ufe00-\ufe0f\ufeff\uffa0\ufdd0-\ufdef\ufff0-\uffff\ud800-\udfff\U000e0000-\U000e0fff"
)
"""Signs that are not seen, or turn what stands beside them: an id with one is read as another id."""
_URI = re.compile(rf'[A-Za-z][A-Za-z0-9+.\-]*:[^\s<>"{{}}|\\^`\x00-\x20\x7f-\xa0{_UNSEEN}]+')
_UNFIT_IN_NAMES = re.compile(r"[\s<>\"'=;,|(){}\[\]\\^`\x00-\x1f\x7f]")
_SHORT_NAME = re.compile(r"[^\W\d_][\w\-]*")
_SCOPE = re.compile(r"/?[^\W\d_]\w*(?:/[^\W\d_]\w*)*")


def inside(tenant: str, snapshot_id: str) -> str:
    """Return the name under which what belongs to a snapshot of a tenant is kept, as if it were a tenant."""
    return f"{_INSIDE}{tenant}{_INSIDE}{snapshot_id}"


def outside(name: str) -> tuple[str, str | None]:
    """Return the tenant that a name means to others, and the snapshot if it is that of one."""
    if not name.startswith(_INSIDE):
        return name, None
    _, tenant, snapshot_id = name.split(_INSIDE, 2)
    return tenant, snapshot_id


def tenant_headers(name: str) -> list[tuple[str, str]]:
    """Return the headers by which others learn of which tenant, and which snapshot of it, something is."""
    tenant, snapshot_id = outside(name)
    told = [("NGSILD-Tenant", tenant)] if tenant else []
    return told if snapshot_id is None else [*told, ("NGSILD-Snapshot", snapshot_id)]


def timestamp(moment: datetime) -> str:
    """Return `moment` as `2024-05-01T12:00:00.123456Z`."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def timestamp_now() -> str:
    """Return the time of the wall clock as the broker writes it."""
    second, micros = divmod(time.time_ns() // 1000, 1_000_000)
    return f"{_second(second)}{micros:06d}Z"


@lru_cache(maxsize=4)
def _second(second: int) -> str:
    """Return all but the fraction, which is the same for thousands of changes."""
    return time.strftime("%Y-%m-%dT%H:%M:%S.", time.gmtime(second))


def moment(text: str) -> float | None:
    """Return an ISO 8601 date or date-time in seconds since 1970 (UTC unless it says); None for others."""
    return _moment(text) if 8 <= len(text) <= MAX_TIME_LENGTH else None


@lru_cache(maxsize=8192)
def _moment(text: str) -> float | None:
    """Return the time; remembered, for the same ones are compared again and again."""
    try:
        parsed = datetime.fromisoformat(text)
        return (parsed if parsed.tzinfo else parsed.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        return None


def is_short_uri(value: str) -> bool:
    """Say whether a text is a URI of a usual length."""
    return len(value) <= MAX_NAME_LENGTH and _is_uri(value)


@lru_cache(maxsize=8192)
def _is_uri(value: str) -> bool:
    """Say whether a short text is a URI; remembered, for what entities refer to comes again and again."""
    return _URI.fullmatch(value) is not None


def require_uri(value: Any, what: str) -> str:
    """Return `value` if it is a URI; raise a problem that names `what` if not."""
    if not isinstance(value, str):
        raise bad_request_data(f"{what} must be a URI such as urn:ngsi-ld:Task:demo:1, not {shown(value)}")
    if len(value) > MAX_ID_LENGTH:
        raise bad_request_data(f"{what} has {len(value)} characters; {MAX_ID_LENGTH} are allowed")
    if not _URI.fullmatch(value):
        raise bad_request_data(
            f"{what} must be a URI such as urn:ngsi-ld:Task:demo:1 without spaces, quotes or brackets, "
            f"not {shown(value)}"
        )
    return value


def is_time(value: Any) -> bool:
    """Say whether this is a date-time that says to be in UTC."""
    return value.__class__ is str and value[-1:] == "Z" and "T" in value and moment(value) is not None


def require_time(value: Any, what: str) -> str:
    """Return a date-time in UTC (clause 4.6.3); one that says how far it is from UTC is told in UTC.

    Raises a problem that names `what` for anything else.
    """
    if is_time(value):
        return str(value)
    if isinstance(value, str) and "T" in value and moment(value) is not None:
        told = datetime.fromisoformat(value)
        if told.tzinfo is not None:
            return told.astimezone(UTC).isoformat().removesuffix("+00:00") + "Z"
    raise bad_request_data(
        f"{what} must be a date-time in UTC such as 2024-05-01T12:00:00Z, not {shown(value)}"
    )


def duration_s(value: Any, what: str) -> float:
    """Return an ISO 8601 duration such as PT5M in seconds, with years of 365 and months of 30 days.

    Raises a problem that names `what` if it is none.
    """
    try:
        return parse_duration(value if isinstance(value, str) else "").nominal_s
    except ValueError:
        raise bad_request_data(
            f"{what} must be a duration such as PT5M or P1DT12H, not {shown(value)}"
        ) from None


def has_expired(expires_at: str | None, now_s: float) -> bool:
    """Say whether a time of expiry, if there is one, has come."""
    return expires_at is not None and (moment(expires_at) or 0.0) <= now_s


def require_future(value: Any, what: str) -> str:
    """Return `value` if it is a date-time to come; raise a problem that names `what` if not."""
    text = require_time(value, what)
    if has_expired(text, time.time()):
        raise bad_request_data(f"{what} is {text}, which is past; give a time to come, or leave it out")
    return text


def require_scope(value: Any) -> str:
    """Return `value` if it is a scope, as it was written; raise a problem if not (clause 4.18)."""
    if not isinstance(value, str) or len(value) > MAX_NAME_LENGTH or not _SCOPE.fullmatch(value):
        raise bad_request_data(
            f"a scope is a path such as /Madrid/Gardens_2, each level a letter followed by letters, digits "
            f"and _ ({MAX_NAME_LENGTH} characters at most), not {shown(value)}"
        )
    return value


def require_name(value: Any, what: str) -> str:
    """Return `value` if it can name a type or an attribute; raise a problem that names `what` if not.

    A short name is a letter followed by letters, digits and _ (clause 4.6.2); the hyphen, which contexts in
    use have in their terms, is taken too. An IRI or `prefix:name` may hold more.
    """
    if not isinstance(value, str) or not value:
        raise bad_request_data(f"{what} must be a name, not {shown(value)}")
    if len(value) <= MAX_NAME_LENGTH and _is_name(value):
        return value
    if len(value) > MAX_NAME_LENGTH:
        raise bad_request_data(f"{what} has {len(value)} characters; {MAX_NAME_LENGTH} are allowed")
    if value.startswith("@") or _UNFIT_IN_NAMES.search(value):
        raise bad_request_data(
            f"{what} {shown(value)} is no name: leave out spaces, quotes, brackets and @ = ; , | < >"
        )
    raise bad_request_data(f"{what} {shown(value)} is no name: a letter, then letters, digits and _")


@lru_cache(maxsize=8192)
def _is_name(value: str) -> bool:
    """Say whether `value` can name something; remembered, for the same names come again and again."""
    if ":" not in value:
        return _SHORT_NAME.fullmatch(value) is not None
    return not value.startswith("@") and _UNFIT_IN_NAMES.search(value) is None


def shown(value: Any) -> str:
    """Return `value` as it may stand in an error: quoted and short."""
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "…"
