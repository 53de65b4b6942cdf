"""Channels and routes: where messages go, and which Alerts go there when.

It is what a client sends and receives as JSON (camelCase), and what the YAML file has.
"""

import re
from datetime import datetime, timedelta
from datetime import time as time_of_day
from enum import StrEnum
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Final, Literal, Self
from urllib.parse import urlsplit
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import yaml
from pydantic import ConfigDict, Field, SecretStr, ValidationError, field_validator, model_validator
from pydantic.alias_generators import to_camel

from handover.errors import UsageError
from handover.formats.strict_json import StrictModel
from handover.formats.validation import fault_text
from handover_datamodels.states import Severity

MAX_CHANNELS: Final = 100
MAX_ROUTES: Final = 200
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_MAIL: Final = re.compile(r"[^@\s<>\",;:\\]{1,64}@[A-Za-z0-9.-]{1,253}")
SEVERITIES: Final = tuple(Severity)
"""Lowest first."""


class Part(StrictModel):
    """A part of the configuration: frozen, without unknown members."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        alias_generator=to_camel,
        validate_by_name=True,
        validate_by_alias=True,
        serialize_by_alias=True,
        allow_inf_nan=False,
    )


class Throttle(Part):
    """At most so many messages in a time; what exceeds them is sent together in one message."""

    maximum: int = Field(20, ge=1, le=10_000)
    per_s: float = Field(600.0, gt=0, le=86_400)


class MailChannel(Part):
    """Mail to some addresses, over the server of HANDOVER_SMTP_URL."""

    type: Literal["mail"] = "mail"
    to: tuple[str, ...] = Field(min_length=1, max_length=50)
    throttle: Throttle = Throttle()

    @field_validator("to")
    @classmethod
    def _are_addresses(cls, addresses: tuple[str, ...]) -> tuple[str, ...]:
        wrong = [address for address in addresses if not _MAIL.fullmatch(address)]
        if wrong:
            raise ValueError(f'"{wrong[0][:100]}" is no mail address, such as anna@example.org')
        return addresses


class WebhookChannel(Part):
    """A POST with the Alert as JSON; `secret` signs it (HMAC-SHA256, header Handover-Signature)."""

    type: Literal["webhook"] = "webhook"
    url: str = Field(max_length=2000)
    secret: SecretStr | None = Field(None, min_length=16, max_length=200)
    throttle: Throttle = Throttle()

    @field_validator("url")
    @classmethod
    def _is_url(cls, url: str) -> str:
        parts = urlsplit(url)
        if parts.scheme not in {"http", "https"} or not parts.hostname or parts.username or parts.fragment:
            raise ValueError("url must be an http or https address, without a user name")
        return url


class AppriseChannel(Part):
    """A messenger by its Apprise URL, such as tgram://…; in the file only. Needs the extra `messengers`."""

    type: Literal["apprise"] = "apprise"
    url: SecretStr
    throttle: Throttle = Throttle()


Channel = Annotated[MailChannel | WebhookChannel | AppriseChannel, Field(discriminator="type")]


class Day(StrEnum):
    """A day of the week."""

    MON = "mon"
    TUE = "tue"
    WED = "wed"
    THU = "thu"
    FRI = "fri"
    SAT = "sat"
    SUN = "sun"


class Hours(Part):
    """Hours on some days; `end` at or before `begin` is on the next day."""

    days: frozenset[Day] = frozenset(Day)
    begin: time_of_day = time_of_day(0, 0)
    end: time_of_day = time_of_day(0, 0)

    def include(self, local: datetime) -> bool:
        """Return whether a local time is within the hours."""
        today, at = list(Day)[local.weekday()], local.time()
        if self.begin < self.end:
            return today in self.days and self.begin <= at < self.end
        before = list(Day)[(local - timedelta(days=1)).weekday()]
        return (today in self.days and at >= self.begin) or (before in self.days and at < self.end)


class Escalation(Part):
    """Channels that are used as well if nobody has acknowledged the Alert `after_s` after it was sent."""

    after_s: float = Field(gt=0, le=7 * 86_400)
    channels: tuple[str, ...] = Field(min_length=1, max_length=10)


class Route(Part):
    """Which Alerts go to which channels. Without a condition it includes every Alert."""

    channels: tuple[str, ...] = Field(min_length=1, max_length=10)
    minimum_severity: Severity = Severity.INFORMATIONAL
    categories: tuple[str, ...] = Field((), max_length=50)
    sub_categories: tuple[str, ...] = Field((), max_length=100)
    sources: tuple[str, ...] = Field((), max_length=50, description="patterns of the id in alertSource")
    places: tuple[str, ...] = Field((), max_length=50, description="patterns of the Location of the source")
    time_zone: str = "UTC"
    hours: tuple[Hours, ...] = Field((), max_length=20, description="only in these hours; always if empty")
    quiet_hours: tuple[Hours, ...] = Field((), max_length=20, description="wait until these have ended")
    urgent_severity: Severity = Field(
        Severity.CRITICAL, description="from this severity on it is never quiet"
    )
    escalations: tuple[Escalation, ...] = Field((), max_length=10)
    send_cleared: bool = Field(True, description="also send that the Alert has returned to normal")
    enabled: bool = True

    @field_validator("time_zone")
    @classmethod
    def _is_zone(cls, name: str) -> str:
        try:
            ZoneInfo(name)
        except (ZoneInfoNotFoundError, ValueError, OSError):
            raise ValueError(f'there is no time zone "{name[:64]}"; write one as Europe/Berlin') from None
        return name

    @model_validator(mode="after")
    def _escalates_in_order(self) -> Self:
        times = [escalation.after_s for escalation in self.escalations]
        if times != sorted(set(times)):
            raise ValueError("escalations must have growing times in afterS")
        return self

    def used_channels(self) -> set[str]:
        """Return the names of all channels of the route."""
        return {*self.channels, *(name for escalation in self.escalations for name in escalation.channels)}

    def is_open(self, at: datetime) -> bool:
        """Return whether the route is used at a time (with a time zone)."""
        local = at.astimezone(ZoneInfo(self.time_zone))
        return not self.hours or any(period.include(local) for period in self.hours)

    def is_quiet(self, at: datetime, severity: Severity) -> bool:
        """Return whether a message of this severity has to wait."""
        if SEVERITIES.index(severity) >= SEVERITIES.index(self.urgent_severity):
            return False
        local = at.astimezone(ZoneInfo(self.time_zone))
        return any(period.include(local) for period in self.quiet_hours)


class Configuration(Part):
    """The content of the file."""

    channels: dict[str, Channel] = Field(default_factory=dict, max_length=MAX_CHANNELS)
    routes: dict[str, Route] = Field(default_factory=dict, max_length=MAX_ROUTES)

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        wrong = [name for name in (*self.channels, *self.routes) if not is_name(name)]
        if wrong:
            raise ValueError(f'"{wrong[0][:64]}" is no name: 1 to 64 letters, digits, "_", "." or "-"')
        for name, route in self.routes.items():
            missing = route.used_channels() - self.channels.keys()
            if missing:
                raise ValueError(f'the route {name} has the channel "{min(missing)}", which does not exist')
        return self


def is_name(name: str) -> bool:
    """Return whether `name` can be the name of a channel or route."""
    return _NAME.fullmatch(name) is not None


def matches(patterns: tuple[str, ...], text: str) -> bool:
    """Return whether one of the patterns fits; True if there is none."""
    return not patterns or any(fnmatchcase(text, pattern) for pattern in patterns)


def read_configuration(file: Path) -> Configuration:
    """Return the channels and routes of a YAML file; raise `UsageError` that names place and fault."""
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UsageError(
            f"the routes {file} cannot be read: {error}; correct HANDOVER_ALERT_ROUTES"
        ) from None
    try:
        return Configuration.model_validate(content)
    except ValidationError as error:
        raise UsageError(f"the routes {file}: {fault_text(error, 'the file')}") from None
