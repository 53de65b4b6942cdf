"""What a broker can do that Handover uses and some lack: found out by probes with entities of their own.

Nothing is tried on entities of others, and nothing is sent that is known to damage a broker: attributes with
several instances in a batch make an entity of Orion-LD 1.6 unreadable for ever, so `BrokerIdentity` decides
about them. What is known of a version counts for it (`_KNOWN`); what was found is kept for each address,
tenant and version in the data directory, and at the next start only what was missing is tried.
"""

import secrets
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import orjson

from handover.broker import MAX_FAULTS, BrokerClient, BrokerError, BrokerFault, BrokerUnavailable
from handover.broker.identity import BrokerIdentity
from handover.files.durable_files import replace_durably
from handover.settings import Settings
from handover.telemetry import get_logger

log = get_logger(__name__)

TYPE: Final = "HandoverProbe"
FILE: Final = "broker-abilities.json"
LONG_AGO: Final = "2000-01-01T00:00:00Z"
LARGE: Final = 1_764_408_000_000
_NOBODY: Final = "http://127.0.0.1:9/nobody"

Probe = Callable[[BrokerClient, str], Awaitable[bool]]
"""Tries an ability, with an id for an entity of its own that is deleted afterwards; raises `BrokerError`."""


@dataclass(frozen=True, slots=True)
class Ability:
    """Something that a broker can do: what does not work without it, and what helps."""

    name: str
    without: str
    remedy: str
    probe: Probe | None = None


@dataclass(frozen=True, slots=True)
class FoundAbilities:
    """A broker and what it can do, by the name of each ability."""

    identity: BrokerIdentity
    are_there: Mapping[str, bool]

    @property
    def broker(self) -> str:
        """The broker by name and version."""
        named = f"{self.identity.name} {self.identity.version}".strip()
        return named or "a broker that does not say its name"

    def missing(self) -> list[Ability]:
        """Return what is not there."""
        return [ability for ability in ABILITIES if not self.are_there[ability.name]]

    def summary(self) -> str:
        """Return one line: which broker it is, and what is not there."""
        missing = ", ".join(ability.name for ability in self.missing())
        return f"{self.broker}; not there: {missing} (handover doctor says more)" if missing else self.broker


async def find_abilities(broker: BrokerClient, settings: Settings) -> FoundAbilities:
    """Return what the broker of the settings can do. Raises `BrokerUnavailable`."""
    identity = await broker.identity()
    if identity.is_ours:
        return FoundAbilities(identity, dict.fromkeys((ability.name for ability in ABILITIES), True))
    file = settings.data_dir / FILE
    key = [broker.url, settings.broker_tenant or "", identity.name, identity.version]
    kept = _kept(file, key) if identity.version else {}
    # What was missing is tried again: a flag of the broker, or a service beside it, may have added it.
    present = {name: True for name, is_there in kept.items() if is_there}
    present |= _KNOWN.get((identity.name, identity.version), {})
    answers = {ability.name: await _has(broker, settings, ability, present) for ability in ABILITIES}
    if answers != kept:
        with suppress(OSError):  # it is found again at the next start
            replace_durably(file, orjson.dumps({"broker": key, "abilities": answers}))
    result = FoundAbilities(identity, answers)
    if result.missing():
        log.warning("the broker cannot do everything", summary=result.summary())
    return result


def _kept(file: Path, key: list[str]) -> dict[str, bool]:
    try:
        kept: Any = orjson.loads(file.read_bytes())
        answers = {str(name): bool(is_there) for name, is_there in kept["abilities"].items()}
        is_whole = kept["broker"] == key and answers.keys() == {ability.name for ability in ABILITIES}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return {}
    return answers if is_whole else {}


async def _has(
    broker: BrokerClient, settings: Settings, ability: Ability, present: Mapping[str, bool]
) -> bool:
    if ability.name in present:
        return present[ability.name]
    if ability.probe is None:
        return False
    for _ in range(MAX_FAULTS):
        entity = settings.entity_id(TYPE, f"{ability.name}-{secrets.token_hex(4)}")
        try:
            return await ability.probe(broker, entity)
        except BrokerFault:
            continue
        except BrokerUnavailable:
            raise
        except BrokerError:
            return False
        finally:
            with suppress(BrokerError):
                await broker.delete(entity)
    return False


def _entity(entity: str, content: Any = 1) -> dict[str, Any]:
    return {"id": entity, "type": TYPE, "n": {"type": "Property", "value": content}}


async def _keeps(broker: BrokerClient, entity: str, content: Any) -> bool:
    await broker.create(_entity(entity, content))
    return bool(await _value(broker, entity) == content)


async def _value(broker: BrokerClient, entity: str) -> Any:
    attribute = (await broker.retrieve(entity)).get("n")
    return attribute.get("value") if isinstance(attribute, Mapping) else None


async def _keeps_large_integers(broker: BrokerClient, entity: str) -> bool:
    return await _keeps(broker, entity, {"at": LARGE})


async def _keeps_lists_of_one(broker: BrokerClient, entity: str) -> bool:
    return await _keeps(broker, entity, {"steps": [1]})


async def _counts(broker: BrokerClient, entity: str) -> bool:
    await broker.create(_entity(entity))
    return await broker.count(type=TYPE, id=entity) == 1


async def _upserts(broker: BrokerClient, entity: str) -> bool:
    await broker.upsert([_entity(entity)])
    await broker.upsert([_entity(entity, 2)])
    return bool(await _value(broker, entity) == 2)


async def _has_history(broker: BrokerClient, entity: str) -> bool:
    await broker.create(_entity(entity))
    evolutions = await broker.evolution(LONG_AGO, type=TYPE, id=entity)
    await broker.delete_evolution(entity)
    return [evolution.get("id") for evolution in evolutions] == [entity]


async def _keeps_receiver_info(broker: BrokerClient, entity: str) -> bool:
    subscription = entity.replace(TYPE, "Subscription", 1)
    endpoint = {
        "uri": _NOBODY,
        "accept": "application/json",
        "receiverInfo": [{"key": "Handover-Probe", "value": "1"}],
    }
    try:
        await broker.ensure_subscription(
            {
                "id": subscription,
                "type": "Subscription",
                "entities": [{"type": TYPE, "id": entity}],
                "notification": {"endpoint": endpoint},
            }
        )
        stored = await broker.subscription(subscription)
        return "receiverInfo" in stored.get("notification", {}).get("endpoint", {})
    finally:
        with suppress(BrokerError):
            await broker.delete_subscription(subscription)


ABILITIES: Final = (
    Ability(
        "upsert",
        "nothing of devices and persons is written",
        "use a broker with entityOperations/upsert",
        _upserts,
    ),
    Ability(
        "receiverInfo",
        "services refuse all notifications and read the broker every HANDOVER_RECONCILE_S",
        "use a broker that sends receiverInfo",
        _keeps_receiver_info,
    ),
    Ability(
        "count",
        "unfinished Tasks and Processes are listed to be counted",
        "use a broker that answers with NGSILD-Results-Count",
        _counts,
    ),
    Ability(
        "history",
        "events of entities that were missed are not found, and no history is deleted here",
        "a service beside the broker has it (Orion-LD: Mintaka)",
        _has_history,
    ),
    Ability(
        "largeIntegers",
        "integers beyond 2147483647 are changed, except in parameters of Tasks",
        "write them as floats or texts",
        _keeps_large_integers,
    ),
    Ability(
        "listsOfOne",
        "a list with one element is read as the element, except in parameters of Tasks",
        "start Orion-LD with -noArrayReduction",
        _keeps_lists_of_one,
    ),
    Ability(
        "instances",
        "the values of each sensor beside the fused one are not written",
        "read them from human state",
    ),
)

_KNOWN: Final[Mapping[tuple[str, str], Mapping[str, bool]]] = {
    ("Orion-LD", "1.6.0"): {
        "upsert": True,
        "receiverInfo": True,
        "count": True,
        "history": False,
        "largeIntegers": False,
        "instances": False,
    }
}
"""What was observed of a version. Lists of one depend on a flag, and are tried."""
