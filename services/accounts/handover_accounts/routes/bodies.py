"""The bodies of requests."""

from typing import Annotated

from pydantic import ConfigDict, Field

from handover.formats.strict_json import StrictModel
from handover_accounts.passwords import MAX_CHARACTERS

Name = Annotated[str, Field(min_length=1, max_length=64)]
Password = Annotated[str, Field(min_length=1, max_length=MAX_CHARACTERS)]
Secret = Annotated[str, Field(min_length=1, max_length=100)]
Id = Annotated[str, Field(min_length=1, max_length=64)]
Text = Annotated[str, Field(max_length=1000)]


class _Body(StrictModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TokenBody(_Body):
    """A token of which a service asks whose it is."""

    token: Annotated[str, Field(max_length=200)]


class SubjectBody(_Body):
    """A user or a token of which a service asks for the present grants."""

    subject: Id


class Place(_Body):
    """Where a person is, as the page server sees it."""

    address: Annotated[str, Field(max_length=64)] = ""
    device: Annotated[str, Field(max_length=300)] = ""


class SignIn(Place):
    """A name and a password."""

    name: Name
    password: Password


class SessionBody(_Body):
    """The token of a session."""

    session: Secret


class SessionEnd(SessionBody):
    """The session that ends; `returnTo` is the page that follows a sign-out at the provider.

    A station is signed out with the `pin` of the person who has joined it, or of an engineer.
    """

    return_to: Annotated[str | None, Field(max_length=1000, alias="returnTo")] = None
    pin: Annotated[str | None, Field(max_length=100)] = None


class ProviderSignInBegin(Place):
    """The address of the page server to which the provider sends the browser back."""

    redirect_uri: Annotated[str, Field(max_length=1000, alias="redirectUri")]


class ProviderAnswer(Place):
    """What a browser brings back from the provider, with the secret of its cookie."""

    secret: Secret
    state: Annotated[str, Field(max_length=200)]
    code: Annotated[str, Field(min_length=1, max_length=4000)]
    iss: Annotated[str, Field(max_length=300)] | None = None


class IdentityChange(_Body):
    """The subject (`sub`) of a user at the provider; null for none."""

    subject: Annotated[str, Field(min_length=1, max_length=255)] | None


class NewStation(_Body):
    """A station: its name, its gloves, what it may do, and when people leave it by time."""

    name: Name
    gloves: list[Annotated[str, Field(min_length=1, max_length=64)]] = Field([], max_length=10)
    resources: list[Annotated[str, Field(min_length=1, max_length=300)]] = Field(["*"], max_length=20)
    leave_after_min: Annotated[float, Field(gt=0, le=1440, alias="leaveAfterMin")] = 15.0


class StationSignIn(SessionBody, Place):
    """The session of an engineer, which becomes that of a station."""

    station: Id


class Identification(_Body):
    """By what a person is recognized."""

    method: Annotated[str, Field(pattern="^(badge|qr|pin)$")]
    value: Annotated[str, Field(min_length=1, max_length=100)]


class GestureIdentification(_Body):
    """A gesture that a glove has held while its station had no Task."""

    glove: Annotated[str, Field(min_length=1, max_length=64)]
    gesture: Annotated[str, Field(min_length=1, max_length=100)]


class PinCheck(_Body):
    """The PIN that a person entered, before the completion of a Task."""

    person: Annotated[str, Field(min_length=1, max_length=300)]
    pin: Annotated[str, Field(min_length=1, max_length=100)]
    task: Annotated[str, Field(min_length=1, max_length=500)]


class PerformerClaim(_Body):
    """The Person whom a service has identified as who performed a Task."""

    person: Annotated[str, Field(min_length=1, max_length=300)]
    task: Annotated[str, Field(min_length=1, max_length=500)]


class IdentifierChange(_Body):
    """An identifier; null to remove it. The content of a QR code is made by the server."""

    value: Annotated[str, Field(min_length=1, max_length=100)] | None


class LinkBody(_Body):
    """The secret of a one-time link."""

    link: Secret


class LinkUse(Place):
    """A one-time link, with the password and, for a new user, the name."""

    link: Secret
    name: Name | None = None
    password: Password


class NewAccountRequest(Place):
    """A request for an account."""

    name: Name
    contact: Annotated[str, Field(max_length=200)] = ""
    note: Text = ""


class PasswordChange(SessionBody, Place):
    """The current and the new password of the user of a session."""

    current: Password
    new: Password


class UserChange(_Body):
    """The Person entity of a user; null for none."""

    person: Annotated[str, Field(max_length=300, pattern=r"^urn:\S+$")] | None


class GrantBody(_Body):
    """A role for the resources that a pattern includes."""

    role: Annotated[str, Field(max_length=32)]
    resource: Annotated[str, Field(min_length=1, max_length=300)] = "*"


Grants = Annotated[list[GrantBody], Field(max_length=100)]


class NewGrant(GrantBody):
    """A grant for a user or token."""

    subject: Id


class NewInvitation(_Body):
    """An invitation, with the grants that the person will have."""

    name: Name | None = None
    grants: Grants = Field([])


class NewToken(_Body):
    """A token of a script or device."""

    kind: Annotated[str, Field(pattern="^(script|device)$")]
    name: Name
    grants: Grants = Field([])
    valid_days: Annotated[float, Field(gt=0, le=3650)] | None = Field(None, alias="validDays")
