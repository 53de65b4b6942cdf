"""What a broker lacks: each rule changes or refuses a request as a genuine broker was seen to do.

A profile is a set of rules. The rules damage what is written, so that reading, queries and notifications of
the broker behind agree with each other.
"""

from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Final, Protocol

BATCHES: Final = frozenset(f"entityOperations/{name}" for name in ("create", "upsert", "update", "merge"))
CORE_TERMS: Final = frozenset({"start", "end", "endTime", "expires", "time", "relationships"})
"""Attributes that the core contexts 1.3 to 1.6 define."""
MAX_BODY_BYTES: Final = 1 << 20


@dataclass(frozen=True)
class Answer:
    """An answer of the strict broker itself."""

    status: int
    body: Any = None
    headers: Mapping[str, str] | None = None


class Refused(Exception):
    """The request is answered by the strict broker."""

    def __init__(self, answer: Answer) -> None:
        self.answer = answer


def problem(status: int, title: str, detail: str = "") -> Answer:
    kind = {400: "BadRequestData", 404: "ResourceNotFound", 501: "OperationNotSupported"}
    name = kind.get(status, "InternalError")
    return Answer(
        status, {"type": f"https://uri.etsi.org/ngsi-ld/errors/{name}", "title": title, "detail": detail}
    )


class Call(Protocol):
    """A request, whose body and parameters a rule may change."""

    method: str
    path: str
    """Below /ngsi-ld/v1/ without quoting; with a leading / if it is elsewhere."""
    params: dict[str, str]
    headers: dict[str, str]
    body: Any
    size: int
    """Bytes of the body."""
    entities: list[dict[str, Any]]
    """The entities or fragments that the body has."""
    is_database_away: bool
    creating: set[str]
    """The entities that other requests are creating now."""

    async def stored(self, path: str) -> dict[str, Any] | None:
        """Return a document of the broker behind."""
        ...

    def refuse(self, entity: dict[str, Any], status: int, title: str) -> None:
        """Refuse an entity: the whole request, or one of its batch."""
        ...

    def leave_out(self, names: list[str]) -> None:
        """Leave attributes out of an update, and report them in the form of Orion-LD."""
        ...

    def spoil(self, entity: dict[str, Any]) -> None:
        """Make an entity and queries of its type unreadable from now on."""
        ...

    def is_spoiled(self) -> bool: ...


Check = Callable[[Call], Awaitable[Answer | None]]


@dataclass(frozen=True)
class Rule:
    """`ability` is what a broker without the rule can do."""

    name: str
    ability: str
    check: Check


RULES: Final[dict[str, Rule]] = {}


def rule(name: str, ability: str) -> Callable[[Check], Check]:
    def add(check: Check) -> Check:
        RULES[name] = Rule(name, ability, check)
        return check

    return add


@rule("own-paths", "health under /readyz and /healthz")
async def _own_paths(call: Call) -> Answer | None:
    return problem(501, "Not Implemented", call.path) if call.path.startswith("/") else None


@rule("large-body", "a body of more than 1 MiB")
async def _large_body(call: Call) -> Answer | None:
    return problem(413, "Request Entity Too Large") if call.size > MAX_BODY_BYTES else None


@rule("database", "errors while its database is away, instead of empty answers")
async def _database(call: Call) -> Answer | None:
    if not call.is_database_away:
        return None
    if (call.method, call.path) == ("GET", "entities"):
        return Answer(200, [], {"NGSILD-Results-Count": "0"} if call.params.get("count") == "true" else None)
    is_known_case = call.path.startswith("entities/") and call.method in {"GET", "PATCH"}
    return problem(404, "Entity Not Found") if is_known_case else problem(500, "Database Error")


@rule("history", "history: GET and DELETE /temporal/entities")
async def _history(call: Call) -> Answer | None:
    is_history = call.path.startswith("temporal/") and call.method in {"GET", "DELETE"}
    return problem(501, "Not Implemented", "the temporal API is a service of its own") if is_history else None


@rule("batch-merge", "batch merge")
async def _batch_merge(call: Call) -> Answer | None:
    return problem(404, "Invalid service path") if call.path == "entityOperations/merge" else None


@rule("projection", "the parameters pick, omit and join")
async def _projection(call: Call) -> Answer | None:
    names = sorted(call.params.keys() & {"pick", "omit", "join"})
    return problem(400, "Invalid URL parameter", ", ".join(names)) if names else None


@rule("order", "the parameter orderBy")
async def _order(call: Call) -> Answer | None:
    call.params.pop("orderBy", None)
    return None


@rule("notification-trigger", "notificationTrigger of subscriptions")
async def _notification_trigger(call: Call) -> Answer | None:
    is_asked = _is_subscription(call) and "notificationTrigger" in call.body
    return problem(501, "Not Implemented", "notificationTrigger") if is_asked else None


@rule("revival", "a new expiresAt for an expired subscription")
async def _revival(call: Call) -> Answer | None:
    if call.method == "PATCH" and _is_subscription(call) and "expiresAt" in call.body:
        ends = (await call.stored(call.path) or {}).get("expiresAt")
        if ends is not None and datetime.fromisoformat(ends) <= datetime.now(UTC):
            del call.body["expiresAt"]
            return None if call.body else Answer(204)
    return None


@rule("receiver-info", "the removal of receiverInfo by a new endpoint without it")
async def _receiver_info(call: Call) -> Answer | None:
    notification = call.body.get("notification") if _is_subscription(call) else None
    endpoint = notification.get("endpoint") if isinstance(notification, dict) else None
    if call.method == "PATCH" and isinstance(endpoint, dict) and "receiverInfo" not in endpoint:
        before = (await call.stored(call.path) or {}).get("notification", {}).get("endpoint", {})
        # Our broker shows it without its values, and keeps the values if it gets it back so.
        endpoint |= {name: before[name] for name in ("receiverInfo",) if name in before}
    return None


@rule("batch-instances", "several instances of an attribute in batch upsert and update")
async def _batch_instances(call: Call) -> Answer | None:
    if call.is_spoiled():
        return problem(500, "Database Error", "an entity cannot be read")
    if call.path in {"entityOperations/upsert", "entityOperations/update"}:
        for entity in call.entities:
            if any(_is_list_of_instances(value) for value in entity.values()):
                if await call.stored(f"entities/{entity.get('id')}") is not None:
                    call.spoil(entity)
                    return problem(500, "Internal Error")
                call.refuse(entity, 501, "Not Implemented")
    return None


@rule("core-terms", f"attributes with the names {', '.join(sorted(CORE_TERMS))}")
async def _core_terms(call: Call) -> Answer | None:
    for entity in call.entities:
        if names := sorted(CORE_TERMS & entity.keys()):
            call.refuse(entity, 400, f"Invalid value of a term of the core context: {names[0]}")
    return None


@rule("list-property", "ListProperty")
async def _list_property(call: Call) -> Answer | None:
    for entity in call.entities:
        if any(isinstance(value, dict) and value.get("type") == "ListProperty" for value in entity.values()):
            call.refuse(entity, 400, "Invalid type of attribute: ListProperty")
    return None


@rule("large-integers", "integers of more than 31 bits")
async def _large_integers(call: Call) -> Answer | None:
    for entity in call.entities:
        entity.update({name: _wrapped(value) for name, value in entity.items() if name != "@context"})
    return None


@rule("list-of-one", "lists of one element")
async def _list_of_one(call: Call) -> Answer | None:
    for entity in call.entities:
        for attribute in _attributes(entity):
            if attribute.get("type") != "GeoProperty" and "value" in attribute:
                attribute["value"] = _reduced(attribute["value"])
    return None


@rule("scope-and-expiry", "scope and expiresAt of entities")
async def _scope_and_expiry(call: Call) -> Answer | None:
    for entity in call.entities:
        for name in ("scope", "expiresAt"):
            entity.pop(name, None)
    return None


@rule("new-attributes", "new attributes by PATCH attrs")
async def _new_attributes(call: Call) -> Answer | None:
    place = call.path.split("/")
    if call.method == "PATCH" and len(place) == 3 and place[2] == "attrs" and call.entities:
        present = await call.stored(f"entities/{place[1]}")
        (given,) = call.entities
        if present is not None and (new := sorted(given.keys() - present.keys() - {"@context"})):
            call.leave_out(new)
    return None


@rule("concurrent-creations", "two creations of one entity at once")
async def _concurrent_creations(call: Call) -> Answer | None:
    is_second = call.path == "entities" and any(one.get("id") in call.creating for one in call.entities)
    return problem(500, "Database Error", "try again") if is_second else None


async def _context_rule(call: Call) -> Answer | None:
    """Do nothing: the server applies the rules of contexts where it loads them."""


RULES["context-version"] = Rule(
    "context-version", '"@version" and other plain values in an @context', _context_rule
)
RULES["context-cache"] = Rule("context-cache", "an @context that changes at its URL", _context_rule)


@dataclass(frozen=True)
class Profile:
    """The rules of a broker, and what it answers to GET /ngsi-ld/ex/v1/version (None: passed on)."""

    name: str
    rules: frozenset[str] = frozenset()
    version: Mapping[str, str] | None = None

    def without(self, *names: str) -> "Profile":
        """Return the profile without some rules."""
        if unknown := ", ".join(sorted(set(names) - RULES.keys())):
            raise ValueError(f"there is no rule {unknown}; the rules are {', '.join(RULES)}")
        return replace(self, rules=self.rules - set(names))


_VERSION: Final = {"orionld version": "1.6.0", "orion version": "1.15.0-next", "branch": "release/1.6.0"}
ORION_LD: Final = Profile("orion-ld-1.6.0", frozenset(RULES), _VERSION)
PLAIN: Final = Profile("plain")


def profile_of(text: str) -> Profile:
    """Return the profile of a name, with the rules that it leaves out: `orion-ld-1.6.0 -history`."""
    name, *left_out = text.split()
    return {one.name: one for one in (ORION_LD, PLAIN)}[name].without(*(one[1:] for one in left_out))


def _is_subscription(call: Call) -> bool:
    return call.path.partition("/")[0] == "subscriptions" and isinstance(call.body, dict)


def _attributes(entity: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for value in entity.values():
        yield from (one for one in (value if isinstance(value, list) else [value]) if isinstance(one, dict))


def _is_list_of_instances(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(one, dict) and "type" in one for one in value)


def _wrapped(value: Any) -> Any:
    """Return a JSON value with its integers in 32 bits."""
    if isinstance(value, dict):
        return {name: _wrapped(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_wrapped(one) for one in value]
    is_integer = isinstance(value, int) and not isinstance(value, bool)
    return (value + 2**31) % 2**32 - 2**31 if is_integer else value


def _reduced(value: Any) -> Any:
    """Return a JSON value with the element in place of each list of one."""
    if isinstance(value, dict):
        return {name: _reduced(one) for name, one in value.items()}
    if isinstance(value, list):
        return _reduced(value[0]) if len(value) == 1 else [_reduced(one) for one in value]
    return value
