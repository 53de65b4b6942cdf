"""The whole copy from one broker to another: all tenants, then the result."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any, Final

import orjson

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, Credentials
from handover.broker_copy.broker_side import BrokerPlace, BrokerSide
from handover.broker_copy.document_copy import (
    REGISTRATIONS,
    SOURCE_SUBSCRIPTIONS,
    SUBSCRIPTIONS,
    DocumentCopy,
)
from handover.broker_copy.entity_copy import EntityCopy
from handover.broker_copy.report import Say, TenantReport
from handover.errors import HandoverError, UsageError
from handover.settings import Settings

HISTORY_STAYS: Final = "history (the temporal evolution) is not copied: it stays in the source"
_IDENTITY: Final = "/info/sourceIdentity"


@dataclass
class CopyReport:
    """The result of a copy; `error` is why it ended early."""

    source: str
    target: str
    tenants: list[TenantReport] = field(default_factory=list)
    error: str | None = None

    @property
    def is_equal(self) -> bool:
        """Whether the target has everything, and the same."""
        return self.error is None and not any(report.problem_count for report in self.tenants)

    def as_json(self) -> dict[str, Any]:
        """Return the report as a JSON object."""
        return {
            "from": self.source,
            "to": self.target,
            "isEqual": self.is_equal,
            "error": self.error,
            "history": "notCopied",
            "tenants": [report.as_json() for report in self.tenants],
        }


async def place_at(settings: Settings, credentials: Credentials | None) -> BrokerPlace:
    """Return the broker of the settings after asking which one it is. Raises `BrokerUnavailable`."""
    async with _client(settings, credentials) as client:
        return BrokerPlace(settings, await client.identity(), credentials)


def _client(settings: Settings, credentials: Credentials | None) -> BrokerClient:
    """Return a client of the default tenant."""
    there = settings.model_copy(update={"broker_tenant": None, "context_url": ""})
    return BrokerClient(there, credentials=credentials)


async def tenants_of(place: BrokerPlace) -> tuple[str, ...] | None:
    """Return the named tenants of the embedded broker; None of a broker that has no list of them."""
    if not place.identity.is_ours:
        return None
    identity = await _identity(place)
    extras = identity.get("contextSourceExtras") if isinstance(identity, Mapping) else None
    names = extras.get("tenants") if isinstance(extras, Mapping) else None
    return tuple(map(str, names)) if isinstance(names, list) else None


async def copy_broker(
    source: BrokerPlace, target: BrokerPlace, tenants: Sequence[str], say: Say, *, overwrites: bool = False
) -> CopyReport:
    """Copy the tenants ("" is the default one) and compare both sides.

    A broker that does not answer, or refuses access, ends the copy: the report has the error.
    """
    report = CopyReport(source.url, target.url)
    try:
        await _require_two(source, target)
        for tenant in tenants:
            entry = TenantReport(tenant, say)
            report.tenants.append(entry)
            say(f"{entry.title}:")
            await _copy_tenant(source, target, entry, overwrites=overwrites)
            if tenant and entry.is_empty:
                entry.problem("tenant", tenant, "the source has nothing in it; is its name right?")
        if all(entry.is_empty for entry in report.tenants):
            report.error = f"{source.url} has nothing to copy; are the address and the tenants right?"
    except BrokerError as error:
        report.error = explained(error, "What was copied stays copied")
    except UsageError:
        raise
    except HandoverError as error:
        report.error = str(error)
    return report


def explained(error: BrokerError, state: str) -> str:
    """Return an error that ended the copy, with the way out; `state` says what was copied."""
    if error.status in {HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN}:
        return f"{error}; give a token with the right for it: --from-token-file, --to-token-file"
    if isinstance(error, BrokerUnavailable):
        return f"{error}. {state}: start the broker, and give the same command again"
    return f"{error}. {state}"


async def _copy_tenant(
    source: BrokerPlace, target: BrokerPlace, report: TenantReport, *, overwrites: bool
) -> None:
    tenant = report.tenant or None
    async with BrokerSide(source, tenant) as first, BrokerSide(target, tenant) as second:
        documents = DocumentCopy(first, second, report, overwrites=overwrites)
        entities = EntityCopy(first, second, report, overwrites=overwrites)
        await documents.copy_contexts()
        await entities.copy()
        await entities.compare()
        # After the entities: subscribers are not notified of each, and no creation is forwarded to a source.
        for kind in (SUBSCRIPTIONS, SOURCE_SUBSCRIPTIONS, REGISTRATIONS):
            await documents.copy(kind)


async def _require_two(source: BrokerPlace, target: BrokerPlace) -> None:
    """Raise `UsageError` if both are one broker."""
    first, second = await _identity(source), await _identity(target)
    aliases = [
        source_identity.get("contextSourceAlias") if isinstance(source_identity, Mapping) else None
        for source_identity in (first, second)
    ]
    if source.url == target.url or (aliases[0] is not None and aliases[0] == aliases[1]):
        raise UsageError(f"{source.url} and {target.url} are one broker; name another one to copy to")


async def _identity(place: BrokerPlace) -> Any:
    """Return what the broker says about itself (clause 5.15); None if it does not."""
    async with _client(place.settings, place.credentials) as client:
        try:
            return orjson.loads((await client.request("GET", _IDENTITY)).body)
        except BrokerUnavailable:
            raise
        except (BrokerError, orjson.JSONDecodeError):
            return None
