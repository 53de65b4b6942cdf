"""Writers: each writes entities of its own with every operation, and records what was acknowledged."""

import random
import threading
from collections.abc import Callable
from typing import Any

import httpx

THINGS_EACH = 8
JSON_LD_FREE = {"endpoint": {"uri": "http://127.0.0.1:9/notify", "accept": "application/json"}}

State = dict[str, Any] | None
"""The state of an entity or subscription, None if it does not exist."""


class Writer(threading.Thread):
    """Writes to one broker until it ends or `over` is set, and records acknowledgements.

    `acknowledged` is what the broker has promised; `attempted` what was asked for last, and may or may not
    be there when the answer never came.
    """

    def __init__(self, broker: Any, number: int, before: "Writer | None" = None) -> None:
        super().__init__(daemon=True)
        self.broker = broker
        self.number = number
        self.dice = before.dice if before else random.Random(number)
        self.acknowledged: dict[str, State] = before.acknowledged if before else {}
        self.attempted: dict[str, State] = before.attempted if before else {}
        self.notified: dict[str, list[int]] = before.notified if before else {}
        self.count = before.count if before else 0
        self.ways: dict[str, int] = before.ways if before else {}
        self.failures: list[str] = []
        self.over = threading.Event()

    def run(self) -> None:
        with self.broker.client() as http:
            while not self.over.is_set():
                self.count += 1
                try:
                    self._write(http)
                except httpx.TransportError:
                    return

    def _write(self, http: httpx.Client) -> None:
        if self.dice.random() < 0.1:
            self._write_document(http)
            return
        thing = f"urn:ngsi-ld:Load:demo:{self.number}-{self.dice.randrange(THINGS_EACH)}"
        known = self.acknowledged.get(thing)
        ways = _WAYS if known is not None else _BEGINNINGS
        self._carry_out(http, thing, known, self.dice.choice(ways))

    def _carry_out(self, http: httpx.Client, thing: str, known: State, way: Callable[..., Any]) -> None:
        intended: dict[str, State] = {}
        send = way(self, thing, known, intended)
        self.attempted.update(intended)
        answer = send(http)
        if not answer.is_success or answer.status_code == 207:
            self.failures.append(f"{way.__name__}: {answer.status_code} {answer.text}")
        self.acknowledged.update(intended)
        self.ways[way.__name__] = self.ways.get(way.__name__, 0) + 1
        for name, state in intended.items():
            if state is not None and "n" in state and "Load" in name:
                self.notified.setdefault(name, []).append(state["n"])

    def _write_document(self, http: httpx.Client) -> None:
        thing = f"urn:ngsi-ld:Subscription:demo:{self.number}-{self.dice.randrange(2)}"
        known = self.acknowledged.get(thing)
        self._carry_out(http, thing, known, _subscribe if known is None else self.dice.choice(_CHANGES))


def _create(writer: Writer, thing: str, _: State, intended: dict[str, State]) -> Any:
    intended[thing] = {"n": writer.count, "pad": "x" * 200}
    return lambda http: http.post("/entities", json={"id": thing, "type": "Load", **(intended[thing] or {})})


def _upsert(writer: Writer, thing: str, _: State, intended: dict[str, State]) -> Any:
    whole = [f"{thing.rsplit('-', 1)[0]}-{number}" for number in range(3)]
    for name in whole:
        intended[name] = {"n": writer.count, "pad": "y"}
    body = [{"id": name, "type": "Load", **(state or {})} for name, state in intended.items()]
    return lambda http: http.post("/entityOperations/upsert", json=body)


def _update(writer: Writer, thing: str, known: State, intended: dict[str, State]) -> Any:
    intended[thing] = {**(known or {}), "n": writer.count}
    if "n" in (known or {}):
        return lambda http: http.patch(f"/entities/{thing}/attrs", json={"n": writer.count})
    return lambda http: http.post(f"/entities/{thing}/attrs", json={"n": writer.count})


def _merge(writer: Writer, thing: str, known: State, intended: dict[str, State]) -> Any:
    intended[thing] = {**(known or {}), "n": writer.count, "merged": writer.count}
    return lambda http: http.patch(f"/entities/{thing}", json={"n": writer.count, "merged": writer.count})


def _append(writer: Writer, thing: str, known: State, intended: dict[str, State]) -> Any:
    intended[thing] = {**(known or {}), "appended": writer.count}
    return lambda http: http.post(f"/entities/{thing}/attrs", json={"appended": writer.count})


def _replace(writer: Writer, thing: str, _: State, intended: dict[str, State]) -> Any:
    intended[thing] = {"n": writer.count}
    return lambda http: http.put(f"/entities/{thing}", json={"type": "Load", "n": writer.count})


def _drop_attribute(writer: Writer, thing: str, known: State, intended: dict[str, State]) -> Any:
    if "n" not in (known or {}):
        return _append(writer, thing, known, intended)
    intended[thing] = {name: value for name, value in (known or {}).items() if name != "n"}
    return lambda http: http.delete(f"/entities/{thing}/attrs/n")


def _delete(_: Writer, thing: str, __: State, intended: dict[str, State]) -> Any:
    intended[thing] = None
    return lambda http: http.delete(f"/entities/{thing}")


def _delete_many(_: Writer, thing: str, __: State, intended: dict[str, State]) -> Any:
    intended[thing] = None
    return lambda http: http.post("/entityOperations/delete", json=[thing])


def _subscribe(writer: Writer, thing: str, _: State, intended: dict[str, State]) -> Any:
    intended[thing] = {"description": str(writer.count)}
    body = {"id": thing, "type": "Subscription", "entities": [{"type": "Nothing"}]}
    return lambda http: http.post(
        "/subscriptions", json={**body, "description": str(writer.count), "notification": JSON_LD_FREE}
    )


def _change_subscription(writer: Writer, thing: str, _: State, intended: dict[str, State]) -> Any:
    intended[thing] = {"description": str(writer.count)}
    return lambda http: http.patch(f"/subscriptions/{thing}", json={"description": str(writer.count)})


def _unsubscribe(_: Writer, thing: str, __: State, intended: dict[str, State]) -> Any:
    intended[thing] = None
    return lambda http: http.delete(f"/subscriptions/{thing}")


_BEGINNINGS = (_create, _create, _upsert)
_WAYS = (
    _update, _update, _update, _merge, _append, _replace, _drop_attribute, _delete, _delete_many, _upsert,
)  # fmt: skip
_CHANGES = (_change_subscription, _unsubscribe)


def _found(http: httpx.Client, thing: str) -> State:
    if ":Subscription:" in thing:
        answer = http.get(f"/subscriptions/{thing}")
        return {"description": answer.json()["description"]} if answer.status_code == 200 else None
    answer = http.get(f"/entities/{thing}", params={"options": "keyValues"})
    if answer.status_code == 404:
        return None
    return {name: value for name, value in answer.json().items() if name not in {"id", "type"}}


def compare(http: httpx.Client, writer: Writer) -> None:
    """Check that the state is as acknowledged, or as the one unanswered request would have made it."""
    for thing, attempted in list(writer.attempted.items()):
        found, acknowledged = _found(http, thing), writer.acknowledged.get(thing)
        if found == acknowledged:
            writer.attempted[thing] = acknowledged
            continue
        assert found == attempted, (thing, "found", found, "promised", acknowledged, "open", attempted)
        writer.acknowledged[thing] = attempted


def things_of(writers: list[Writer]) -> set[str]:
    """Return the ids of the entities that are there, as acknowledged."""
    return {
        thing
        for writer in writers
        for thing, state in writer.acknowledged.items()
        if state is not None and ":Load:" in thing
    }


ALL_WAYS = {way.__name__ for way in (*_BEGINNINGS, *_WAYS, *_CHANGES, _subscribe)}
