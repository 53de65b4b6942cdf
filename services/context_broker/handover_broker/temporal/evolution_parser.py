"""Parses provided evolutions: attributes with any number of instances (clause 4.5.6)."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from handover_broker.model.entity import NULL, VALUE_MEMBER, Attributes, Instance, Terms, is_deletion
from handover_broker.model.entity_parser import (
    VALUE_MEMBERS,
    Nulls,
    expand,
    given_kind,
    read_attribute,
    read_change,
)
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import require_name, shown
from handover_broker.temporal.history import SCOPE

MAX_INSTANCES: Final = 100_000
"""Instances in one request."""

_MEMBERS: Final = frozenset(
    {"id", "@id", "type", "@type", "expiresAt", "createdAt", "modifiedAt", "deletedAt"}
)


@dataclass(frozen=True, slots=True)
class ProvidedEvolution:
    """The evolution of an entity as a client provides it; scopes are instances of the attribute `SCOPE`.

    `expires_at` is the expiry of the history, None if it is not given.
    """

    id: str | None
    types: tuple[str, ...]
    attributes: Attributes
    expires_at: str | None = None

    @property
    def scopes(self) -> tuple[str, ...]:
        """Return the latest scopes, none if there are none."""
        values = [attribute["value"] for attribute in self.attributes.get(SCOPE, ())]
        if not values:
            return ()
        return (values[-1],) if isinstance(values[-1], str) else tuple(values[-1])

    def stamped(self, at: str) -> "ProvidedEvolution":
        """Return a copy with the broker's timestamps for instances that are stored at `at`."""
        attributes = {
            name: [_stamped(instance, at) for instance in instances]
            for name, instances in self.attributes.items()
        }
        return replace(self, attributes=attributes)


def parse_evolution(document: Any, terms: Terms) -> ProvidedEvolution:
    """Return the evolution in a document; raise a problem (400) if it is invalid.

    An instance with the value `NULL` deletes the attribute at its time (clause 5.5.4).
    """
    if not isinstance(document, Mapping):
        raise bad_request_data(f"an entity is a JSON object, not {shown(document)}")
    head = read_change(
        {name: content for name, content in document.items() if name in _MEMBERS}, terms, Nulls.NOWHERE
    )
    attributes: Attributes = {}
    total = 0
    for name, content in document.items():
        if name in _MEMBERS or name == "@context":
            continue
        if name == SCOPE:
            attributes[SCOPE] = _scopes(content, terms)
            continue
        iri = expand(require_name(name, "the attribute name"), terms)
        if iri in attributes:
            raise bad_request_data(
                f"attribute {shown(name)} is given twice, once under another name of {iri}"
            )
        attributes[iri] = _instances(name, content, terms)
        total += len(attributes[iri])
    if total > MAX_INSTANCES:
        raise bad_request_data(
            f"the body has {total} instances; at most {MAX_INSTANCES} are accepted in one request"
        )
    return ProvidedEvolution(head.id, head.types, attributes, head.expires_at)


def _instances(name: str, provided: Any, terms: Terms) -> list[Instance]:
    if (
        not isinstance(provided, list)
        or not provided
        or not all(_is_instance(instance) for instance in provided)
    ):
        provided = [provided]
    # One by one: an attribute may change its type over time, with one datasetId or none.
    parsed = [read_change({name: instance}, terms, Nulls.ATTRIBUTES).attributes for instance in provided]
    return [instance for attributes in parsed for instances in attributes.values() for instance in instances]


def _is_instance(instance: Any) -> bool:
    return isinstance(instance, dict) and (
        given_kind(instance) in VALUE_MEMBER or not VALUE_MEMBERS.isdisjoint(instance)
    )


def _scopes(provided: Any, terms: Terms) -> list[Instance]:
    """Return scopes as instances of a Property (clause 4.5.6), from instances or plain values."""
    listed = (
        provided
        if isinstance(provided, list) and provided and all(_is_instance(part) for part in provided)
        else [provided]
    )
    instances: list[Instance] = []
    for scope in listed:
        instance: Instance = {"type": "Property", "value": scope}
        if isinstance(scope, dict):
            instance = read_attribute(SCOPE, scope, terms)[0]
            if instance["type"] != "Property" or set(instance) - {"type", "value", "observedAt"}:
                raise bad_request_data("a scope is a Property with a value and optionally an observedAt")
        value = instance["value"]
        if value == NULL:
            instances.append({**instance, "value": []})
            continue
        scopes = read_change({SCOPE: value}, terms, Nulls.NOWHERE).scopes or ()
        instances.append({**instance, "value": scopes[0] if len(scopes) == 1 else list(scopes)})
    return instances


def _stamped(instance: Instance, at: str) -> Instance:
    stamped = {**instance, "createdAt": at, "modifiedAt": at}
    if is_deletion(instance):
        stamped["deletedAt"] = at
    return stamped
