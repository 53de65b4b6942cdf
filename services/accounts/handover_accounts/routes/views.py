"""The responses. The page's TypeScript types are generated from them."""

from datetime import UTC, datetime
from typing import Any, NotRequired

from typing_extensions import TypedDict

from handover_datamodels.times import iso


class GrantView(TypedDict):
    """A role for the resources that a pattern includes."""

    id: str
    role: str
    resource: str


class GrantedRole(TypedDict):
    """A grant without its id."""

    role: str
    resource: str


class UserView(TypedDict):
    """A user; `sessions` is the number of open sessions."""

    subject: str
    name: str
    person: str | None
    createdAt: str
    grants: list[GrantView]
    sessions: int
    seenAt: str | None


class MeView(TypedDict):
    """The caller, with the names of the permissions that at least one grant has."""

    kind: str
    subject: str
    name: str
    person: str | None
    grants: list[GrantedRole]
    permissions: list[str]
    hasAccounts: bool


class SessionView(TypedDict):
    """A session, with the place and the device as they were at the sign-in."""

    id: str
    method: str
    address: str
    device: str
    createdAt: str
    seenAt: str
    endsAt: str
    isThis: bool


class TokenView(TypedDict):
    """A token of a script, device or service."""

    subject: str
    kind: str
    name: str
    createdAt: str
    expiresAt: str | None
    usedAt: str | None
    grants: list[GrantView]


class IssuedToken(TypedDict):
    """A new token; it is shown only here."""

    subject: str
    token: str


class LinkView(TypedDict):
    """An open link; the secret of a new one is shown only in the answer that made it."""

    id: str
    purpose: str
    name: str | None
    grants: list[GrantedRole]
    createdAt: str
    expiresAt: str


class NewLink(TypedDict):
    """A new link: the page's address is followed by `/join#` and the secret."""

    id: str
    link: str
    expiresAt: str


class LinkPreview(TypedDict):
    """What a link is for."""

    purpose: str
    name: str | None
    grants: list[GrantedRole]
    expiresAt: str


class AccountRequestView(TypedDict):
    """A request for an account."""

    id: str
    name: str
    contact: str
    note: str
    createdAt: str


class RemainingData(TypedDict):
    """What remains after a deletion, and why."""

    what: str
    count: int
    why: str


class DeletedUser(TypedDict):
    """The result of a deletion."""

    subject: str
    remains: list[RemainingData]


class OpenedSession(TypedDict):
    """The token of a new session, for the cookie."""

    session: str
    maxAgeS: int


class JoinedPerson(TypedDict):
    """The person who has joined a station, how they were recognized, and when."""

    subject: str
    name: str
    person: str | None
    method: str
    since: str


class StationView(TypedDict):
    """A station; `sessions` is the number of screens that are signed in as it."""

    subject: str
    name: str
    gloves: list[str]
    leaveAfterMin: float
    sessions: int
    joined: JoinedPerson | None


class StationJoin(TypedDict):
    """Who has joined the station of some gloves; null for nobody."""

    station: str
    gloves: list[str]
    joined: JoinedPerson | None


class StationJoins(TypedDict):
    """Who has joined each station."""

    stations: list[StationJoin]


class IdentifiersView(TypedDict):
    """By what a user is recognized; `qr` is the content of a new QR code, shown only here."""

    kinds: list[str]
    qr: str | None


class PinResult(TypedDict):
    """Whether it is the PIN of the person, and if so the proof of it for the Task."""

    isRight: bool
    proof: str | None


class PerformerProof(TypedDict):
    """The proof of who performed a Task."""

    proof: str


class SignInOptions(TypedDict):
    """How people may sign in besides by a password: the name of the provider, or null."""

    provider: str | None


class ProviderLocation(TypedDict):
    """Where a browser signs in; `secret` is for its cookie."""

    location: str
    secret: str
    maxAgeS: int


class SignedOut(TypedDict):
    """Where the browser signs out at the provider, or null."""

    location: str | None


class UserToken(TypedDict):
    """The access token of a session; `network` is the only one from which it may be used, or null."""

    token: str
    expiresInS: float
    csrf: str
    isStation: bool
    endsInS: float
    network: str | None


class ServiceToken(TypedDict):
    """The access token of a service."""

    token: str
    expiresInS: float


class Introspection(TypedDict):
    """Whose a token is; only `active`, and `revision` if a subject was asked for, for an unknown one."""

    active: bool
    kind: NotRequired[str]
    subject: NotRequired[str]
    name: NotRequired[str]
    grants: NotRequired[list[GrantedRole]]
    person: NotRequired[str | None]
    session: NotRequired[str | None]
    revision: NotRequired[int]


class Revocations(TypedDict):
    """The number of the last revocation, and the listed ones as `[number, name]`."""

    position: int
    revoked: list[tuple[int, str]]


def time_of(unix_s: float | None) -> Any:
    """Return a Unix time as a text; None for None."""
    return None if unix_s is None else iso(datetime.fromtimestamp(unix_s, UTC))
