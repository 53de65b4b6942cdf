"""Validation of ids, times and names of NGSI-LD."""

import re
import time
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from typing import Any, Final

from handover.errors import Problem
from handover.formats.durations import parse_duration
from handover_broker.model.problems import bad_request_data

MAX_ID_LENGTH = 2048
MAX_NAME_LENGTH = 512
MAX_TENANT_LENGTH = 128
MAX_TIME_LENGTH = 64
MICROS: Final = 1_000_000
"""Microseconds in a second: times are whole microseconds since 1970."""
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)

TENANT = re.compile(rf"[A-Za-z0-9_.\-]{{1,{MAX_TENANT_LENGTH}}}")

_INSIDE = "\u2234"
"""First character of the name of a snapshot's content: no header can contain it, so no client can use it."""

_UNSEEN = (
    r"\u00ad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180e\u200b-\u200f\u2028-\u202f\u2060-\u206f"
    r"\u2800\u3164\ufe00-\ufe0f\ufeff\uffa0\ufdd0-\ufdef\ufff0-\uffff\ud800-\udfff\U000e0000-\U000e0fff"
)
"""Invisible characters, and those that change the direction of text: an id with one looks like another id."""
_URI = re.compile(rf'[A-Za-z][A-Za-z0-9+.\-]*:[^\s<>"{{}}|\\^`\x00-\x20\x7f-\xa0{_UNSEEN}]+')
_ASCII_URI = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]*:[!#-;=?-\[\]_a-z~]+")
"""The URIs that `_URI` matches and that are ASCII: most are, and are matched in a third of the time."""
_UNFIT_IN_NAMES = re.compile(r"[\s<>\"'=;,|(){}\[\]\\^`\x00-\x1f\x7f]")
_SHORT_NAME = re.compile(r"[^\W\d_][\w\-]*")
_SCOPE = re.compile(r"/?[^\W\d_]\w*(?:/[^\W\d_]\w*)*")


def inside(tenant: str, snapshot_id: str) -> str:
    """Return the internal tenant name of the content of a snapshot."""
    return f"{_INSIDE}{tenant}{_INSIDE}{snapshot_id}"


def outside(name: str) -> tuple[str, str | None]:
    """Return the tenant of an internal name, and the snapshot if it is that of one."""
    if not name.startswith(_INSIDE):
        return name, None
    _, tenant, snapshot_id = name.split(_INSIDE, 2)
    return tenant, snapshot_id


def tenant_headers(name: str) -> list[tuple[str, str]]:
    """Return the headers that name a tenant, and a snapshot of it, in requests to others."""
    tenant, snapshot_id = outside(name)
    headers = [("NGSILD-Tenant", tenant)] if tenant else []
    return headers if snapshot_id is None else [*headers, ("NGSILD-Snapshot", snapshot_id)]


def timestamp(moment: datetime) -> str:
    """Return `moment` as `2024-05-01T12:00:00.123456Z`, the form of times of the clock: such texts sort by
    time."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def written_time(at: int) -> str:
    """Return a given or computed time, in microseconds since 1970, with as many decimals (none, three or
    six) as it needs.

    A time that is already a text in UTC is never written again: every representation shows that text.
    Raises `OverflowError` for a time that the calendar does not have.
    """
    since = (_EPOCH + timedelta(microseconds=at)).replace(tzinfo=None)
    digits = "microseconds" if at % 1000 else "milliseconds" if at % MICROS else "seconds"
    return f"{since.isoformat(timespec=digits)}Z"


def timestamp_now() -> str:
    """Return the wall clock time in the format of the broker."""
    second, micros = divmod(time.time_ns() // 1000, 1_000_000)
    return f"{_second(second)}{micros:06d}Z"


@lru_cache(maxsize=4)
def _second(second: int) -> str:
    """Return all but the fraction, which is the same for thousands of changes."""
    return time.strftime("%Y-%m-%dT%H:%M:%S.", time.gmtime(second))


def moment(text: str) -> float | None:
    """Return an ISO 8601 date or date-time in seconds since 1970 (UTC by default); None for anything else."""
    return _moment(text) if 8 <= len(text) <= MAX_TIME_LENGTH else None


@lru_cache(maxsize=8192)
def _moment(text: str) -> float | None:
    """Return the time; cached, because times are compared repeatedly."""
    try:
        parsed = datetime.fromisoformat(text)
        return (parsed if parsed.tzinfo else parsed.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        return None


def is_short_uri(value: str) -> bool:
    """Return whether a text is a URI of usual length."""
    return len(value) <= MAX_NAME_LENGTH and _is_uri(value)


@lru_cache(maxsize=8192)
def _is_uri(value: str) -> bool:
    """Return whether a short text is a URI; cached, because references repeat."""
    return _URI.fullmatch(value) is not None


def require_uri(value: Any, what: str) -> str:
    """Return `value` if it is a URI; raise a problem that names `what` if not."""
    if not isinstance(value, str):
        raise bad_request_data(f"{what} must be a URI such as urn:ngsi-ld:Task:demo:1, not {shown(value)}")
    if len(value) > MAX_ID_LENGTH:
        raise bad_request_data(f"{what} has {len(value)} characters; {MAX_ID_LENGTH} are allowed")
    if not (_ASCII_URI.fullmatch(value) or _URI.fullmatch(value)):
        raise bad_request_data(
            f"{what} must be a URI such as urn:ngsi-ld:Task:demo:1 without spaces, quotes or brackets, "
            f"not {shown(value)}"
        )
    return value


def is_time(value: Any) -> bool:
    """Return whether a value is a date-time in UTC."""
    return value.__class__ is str and value[-1:] == "Z" and "T" in value and moment(value) is not None


def require_time(value: Any, what: str) -> str:
    """Return a date-time in UTC (clause 4.6.3); one with another offset is converted.

    Raises a problem that names `what` for anything else.
    """
    if is_time(value):
        return str(value)
    if isinstance(value, str) and "T" in value and moment(value) is not None:
        instant = datetime.fromisoformat(value)
        if instant.tzinfo is not None:
            with suppress(OverflowError):  # the offset leads out of the calendar
                return written_time((instant - _EPOCH) // timedelta(microseconds=1))
    raise bad_request_data(
        f"{what} must be a date-time in UTC such as 2024-05-01T12:00:00Z, not {shown(value)}"
    )


def duration_s(value: Any, what: str) -> float:
    """Return an ISO 8601 duration such as PT5M in seconds, with years of 365 and months of 30 days.

    Raises a problem that names `what` if it is invalid.
    """
    try:
        return parse_duration(value if isinstance(value, str) else "").nominal_s
    except ValueError:
        raise bad_request_data(
            f"{what} must be a duration such as PT5M or P1DT12H, not {shown(value)}"
        ) from None


def has_expired(expires_at: str | None, now_s: float) -> bool:
    """Return whether an expiry, if there is one, has passed."""
    return expires_at is not None and (moment(expires_at) or 0.0) <= now_s


def require_future(value: Any, what: str) -> str:
    """Return `value` if it is a date-time in the future; raise a problem that names `what` if not."""
    text = require_time(value, what)
    if has_expired(text, time.time()):
        raise bad_request_data(f"{what} is {text}, which is past; give a time in the future, or leave it out")
    return text


def require_scope(value: Any) -> str:
    """Return `value` if it is a scope, unchanged; raise a problem if not (clause 4.18)."""
    if not isinstance(value, str) or len(value) > MAX_NAME_LENGTH or not _SCOPE.fullmatch(value):
        raise bad_request_data(
            f"a scope is a path such as /Madrid/Gardens_2; each level is A-Z or a-z, then digits or _ "
            f"too ({MAX_NAME_LENGTH} characters at most), not {shown(value)}"
        )
    return value


def require_name(value: Any, what: str) -> str:
    """Return `value` if it can name a type or an attribute; raise a problem that names `what` if not.

    A short name is alphanumeric with _, and does not begin with a digit (clause 4.6.2). The hyphen is allowed
    too, because published contexts have it in their terms. An IRI or `prefix:name` may contain more.
    """
    if not isinstance(value, str) or not value:
        raise bad_request_data(f"{what} must be a name, not {shown(value)}")
    if len(value) <= MAX_NAME_LENGTH and _is_name(value):
        return value
    if len(value) > MAX_NAME_LENGTH:
        raise bad_request_data(f"{what} has {len(value)} characters; {MAX_NAME_LENGTH} are allowed")
    if value.startswith("@") or _UNFIT_IN_NAMES.search(value):
        raise bad_request_data(
            f"{what} {shown(value)} is not a valid name: leave out spaces, quotes, brackets and @ = ; , | < >"
        )
    raise bad_request_data(
        f"{what} {shown(value)} is not a valid name: A-Z or a-z, then A-Z, a-z, digits and _"
    )


@lru_cache(maxsize=8192)
def _is_name(value: str) -> bool:
    """Return whether `value` is a valid name; cached, because names repeat."""
    if ":" not in value:
        return _SHORT_NAME.fullmatch(value) is not None
    return not value.startswith("@") and _UNFIT_IN_NAMES.search(value) is None


def without_iri(name: str, expanded: str) -> Problem:
    """Return the problem (400) of a name that its @context expands to no IRI."""
    if expanded.startswith("@"):
        return bad_request_data(
            f"{shown(name)} stands for {expanded} of an entity and names nothing else; leave it out, or "
            "choose another name; queries have the parameters id and type"
        )
    return bad_request_data(f"the @context has no IRI for {shown(name)}; map it to one or add a @vocab")


def shown(value: Any) -> str:
    """Return `value` for an error text: quoted and short."""
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "…"
