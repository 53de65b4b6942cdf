"""What a broker can do, by probes with entities and subscriptions of their own, which are deleted afterwards.

A probe sends nothing that may damage a broker: instances in a batch, which can make an entity of Orion-LD
unreadable for ever, are not tried.
"""

import itertools
import secrets
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any, Final

import httpx

from handover_datamodels.times import iso
from tests.kit.other_broker.profiles import ORION_LD, RULES
from tests.kit.waiting import wait_for

TYPE: Final = "HandoverProbe"
NOBODY: Final = "http://127.0.0.1:9/nobody"


class Probe:
    """Requests to a broker, and what they leave behind until `clean`."""

    def __init__(self, http: httpx.Client) -> None:
        self.http = http
        self._made: list[str] = []
        self._count = itertools.count()
        self._run = secrets.token_hex(6)

    def name(self, kind: str = TYPE) -> str:
        """Return an id that is used once."""
        return f"urn:ngsi-ld:{kind}:probe:{self._run}-{next(self._count)}"

    def create(self, **members: Any) -> httpx.Response:
        """Create an entity."""
        body = {"id": self.name(), "type": TYPE, **members}
        self._made.append(f"entities/{body['id']}")
        context = {"Content-Type": "application/ld+json" if "@context" in body else "application/json"}
        return self.http.post("entities", json=body, headers=context)

    def created(self, **members: Any) -> str:
        """Create an entity and return its id."""
        name = self.name()
        self.create(id=name, **members).raise_for_status()
        return name

    def read(self, name: str) -> dict[str, Any]:
        """Return an entity."""
        found: dict[str, Any] = self.http.get(f"entities/{name}").raise_for_status().json()
        return found

    def subscribe(self, **members: Any) -> tuple[str, httpx.Response]:
        """Create a subscription; return its path and the answer."""
        path = f"subscriptions/{(name := self.name('Subscription'))}"
        self._made.append(path)
        endpoint = {"uri": NOBODY, "accept": "application/json", **members.pop("endpoint", {})}
        body = {
            "id": name,
            "type": "Subscription",
            "entities": [{"type": TYPE}],
            "notification": {"endpoint": endpoint},
            **members,
        }
        return path, self.http.post("subscriptions", json=body)

    def clean(self) -> None:
        """Delete what is left."""
        for path in self._made:
            self.http.delete(path)


def value(content: Any) -> dict[str, Any]:
    return {"type": "Property", "value": content}


def _large_body(probe: Probe) -> bool:
    return probe.create(text=value("x" * (1 << 20))).is_success


def _health(probe: Probe) -> bool:
    return all(probe.http.get(probe.http.base_url.join(path)).is_success for path in ("/healthz", "/readyz"))


def _history(probe: Probe) -> bool:
    path = f"temporal/entities/{probe.created(n=value(1))}"
    return probe.http.get(path).is_success and probe.http.delete(path).is_success


def _batch_merge(probe: Probe) -> bool:
    change = {"id": probe.created(n=value(1)), "type": TYPE, "n": value(2)}
    return probe.http.post("entityOperations/merge", json=[change]).status_code in {200, 204}


def _projection(probe: Probe) -> bool:
    probe.created(n=value(1))
    chosen = ({"pick": "id"}, {"omit": "n"}, {"join": "flat"})
    return all(probe.http.get("entities", params={"type": TYPE, **one}).is_success for one in chosen)


def _order(probe: Probe) -> bool:
    names = [probe.created(rank=value(rank)) for rank in (2, 3, 1)]
    found = probe.http.get("entities", params={"id": ",".join(names), "type": TYPE, "orderBy": "rank"})
    return found.is_success and [one["rank"]["value"] for one in found.json()] == [1, 2, 3]


def _notification_trigger(probe: Probe) -> bool:
    return probe.subscribe(notificationTrigger=["entityCreated"])[1].is_success


def _revival(probe: Probe) -> bool:
    ends = datetime.now(UTC) + timedelta(seconds=2)
    path, answer = probe.subscribe(expiresAt=iso(ends))
    answer.raise_for_status()
    wait_for(lambda: datetime.now(UTC) > ends)
    later = iso(ends + timedelta(hours=1))
    probe.http.patch(path, json={"expiresAt": later})
    after = probe.http.get(path).json()
    return after.get("expiresAt") == later and after.get("status", "active") != "expired"


def _receiver_info(probe: Probe) -> bool:
    path, answer = probe.subscribe(endpoint={"receiverInfo": [{"key": "X-Probe", "value": "1"}]})
    answer.raise_for_status()
    plain = {"endpoint": {"uri": NOBODY, "accept": "application/json"}}
    probe.http.patch(path, json={"notification": plain}).raise_for_status()
    return "receiverInfo" not in probe.http.get(path).json()["notification"]["endpoint"]


def _core_terms(probe: Probe) -> bool:
    return probe.create(start=value("2026-01-01T12:00:00Z")).is_success


def _list_property(probe: Probe) -> bool:
    return probe.create(items={"type": "ListProperty", "valueList": [1, 2]}).is_success


def _keeps(probe: Probe, *contents: Any) -> bool:
    return all(probe.read(probe.created(n=value(one)))["n"]["value"] == one for one in contents)


def _large_integers(probe: Probe) -> bool:
    return _keeps(probe, 2**31, {"at": 1764408000000})


def _list_of_one(probe: Probe) -> bool:
    return _keeps(probe, [7], {"steps": ["one"]})


def _scope_and_expiry(probe: Probe) -> bool:
    members = {"scope": "/probe", "expiresAt": iso(datetime.now(UTC) + timedelta(hours=1))}
    name = probe.created(n=value(1), **members)
    stored = probe.http.get(f"entities/{name}", params={"options": "sysAttrs"}).json()
    return members.keys() <= stored.keys()


def _new_attributes(probe: Probe) -> bool:
    name = probe.created(n=value(1))
    answer = probe.http.patch(f"entities/{name}/attrs", json={"n": value(2), "m": value(3)})
    return answer.status_code == 204 and "m" in probe.read(name)


def _context_version(probe: Probe) -> bool:
    context = {"@version": 1.1, "n": "https://example.org/n"}
    return probe.create(**{"@context": context, "n": value(1)}).is_success


PROBES: Final[Mapping[str, Callable[[Probe], bool]]] = {
    "own-paths": _health,
    "large-body": _large_body,
    "history": _history,
    "batch-merge": _batch_merge,
    "projection": _projection,
    "order": _order,
    "notification-trigger": _notification_trigger,
    "revival": _revival,
    "receiver-info": _receiver_info,
    "core-terms": _core_terms,
    "list-property": _list_property,
    "large-integers": _large_integers,
    "list-of-one": _list_of_one,
    "scope-and-expiry": _scope_and_expiry,
    "new-attributes": _new_attributes,
    "context-version": _context_version,
}
"""The probe of each ability; it returns whether the broker has it."""
NOT_PROBED: Final = RULES.keys() - PROBES.keys()
"""What takes a broken database, an hour, luck, or may damage the broker."""


def has_ability(http: httpx.Client, name: str) -> bool:
    """Return whether the broker of a client, whose base is /ngsi-ld/v1/, has an ability."""
    probe = Probe(http)
    try:
        return PROBES[name](probe)
    finally:
        probe.clean()


def abilities(url: str, *, tenant: str = "") -> dict[str, bool | None]:
    """Return which abilities a broker has; None for one that was not tried.

    For Orion-LD 1.6.0, which says its version, what is known of it counts for those.
    """
    headers = {"NGSILD-Tenant": tenant} if tenant else {}
    with httpx.Client(base_url=f"{url}/ngsi-ld/v1/", headers=headers, timeout=120, trust_env=False) as http:
        answer = http.get(f"{url}/ngsi-ld/ex/v1/version")
        assert ORION_LD.version is not None
        is_known = answer.is_success and ORION_LD.version["orionld version"] in answer.text
        found: dict[str, bool | None] = dict.fromkeys(sorted(NOT_PROBED), False if is_known else None)
        return {**{name: has_ability(http, name) for name in PROBES}, **found}
