"""Instances of attributes in a write, and the part of a document with some of them.

A source may have some datasetIds of an attribute only (clauses 4.3.6.1 and 5.2.9). It is sent these
instances; the others stay here or go to other sources.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Final

from handover_broker.model.context import Context
from handover_broker.model.entity_parser import DEFAULT_INSTANCE, expand
from handover_broker.model.validation import require_name
from handover_federation.registrations.registration import Registration

NO_ATTRIBUTES: Final = frozenset(
    {"id", "@id", "type", "@type", "@context", "scope", "expiresAt", "createdAt", "modifiedAt", "deletedAt"}
)
"""Members of an entity that belong to every part of it."""
ANY: Final = "*"
"""Stands for all datasetIds, or for an unknown one."""
_MANY: Final = "dataset"
"""The member that holds several instances in simplified form (clause 4.5.4)."""

Instances = frozenset[tuple[str, str | None]]
"""Instances by attribute (IRI) and datasetId; None is the default instance."""


def attributes_in(document: Mapping[str, Any], context: Context) -> dict[str, str]:
    """Return the names of the attributes in a document with their IRIs."""
    return {
        name: expand(require_name(name, "the attribute name"), context.terms)
        for name in document
        if name not in NO_ATTRIBUTES
    }


def types_in(document: Mapping[str, Any], context: Context) -> frozenset[str] | None:
    """Return the types (IRIs) in a document, None if there are none."""
    kinds = document.get("type", document.get("@type"))
    names: Iterable[Any] = kinds if isinstance(kinds, list) else [kinds]
    return frozenset(context.terms.expand(name) for name in names if isinstance(name, str) and name) or None


def instances_in(document: Mapping[str, Any], names: Mapping[str, str]) -> Instances:
    """Return the instances in a document; `names` are its attributes with their IRIs."""
    return frozenset((iri, dataset) for name, iri in names.items() for dataset in datasets_in(document[name]))


def datasets_in(value: Any) -> set[str | None]:
    """Return the datasetIds in the value of one attribute, in any representation."""
    if _is_list_of_instances(value):
        return {_dataset_of(instance) for instance in value}
    if _is_many_simplified(value):
        return {_named(dataset) for dataset in value[_MANY]}
    return {_dataset_of(value)}


def part_of(document: Mapping[str, Any], names: Mapping[str, str], wanted: Instances) -> dict[str, Any]:
    """Return a document with these instances only; members that are no attributes stay."""
    by_attribute: dict[str | None, set[str | None]] = {}
    for iri, dataset in wanted:
        by_attribute.setdefault(iri, set()).add(dataset)
    part: dict[str, Any] = {}
    for member, value in document.items():
        datasets = by_attribute.get(names.get(member), set())
        if member in NO_ATTRIBUTES or datasets_in(value) <= datasets:
            part[member] = value
        elif datasets.isdisjoint(datasets_in(value)):
            continue
        elif _is_many_simplified(value):
            part[member] = {
                _MANY: {
                    linked: instance
                    for linked, instance in value[_MANY].items()
                    if _named(linked) in datasets
                }
            }
        else:
            part[member] = [instance for instance in value if _dataset_of(instance) in datasets]
    return part


def instances_of_source(
    registration: Registration, instances: Instances, names: frozenset[str] | None
) -> Instances:
    """Return the instances that a source may have: of attributes (IRIs, None for all) and of its datasets."""
    datasets = registration.datasets
    if names is None and datasets is None:
        return instances
    return frozenset(
        (iri, dataset)
        for iri, dataset in instances
        if (names is None or iri in names) and (datasets is None or dataset == ANY or dataset in datasets)
    )


def _is_list_of_instances(value: Any) -> bool:
    return (
        isinstance(value, list) and bool(value) and all(isinstance(instance, Mapping) for instance in value)
    )


def _is_many_simplified(value: Any) -> bool:
    return isinstance(value, Mapping) and value.keys() == {_MANY} and isinstance(value[_MANY], Mapping)


def _dataset_of(value: Any) -> str | None:
    dataset = value.get("datasetId") if isinstance(value, Mapping) else None
    return _named(dataset) if isinstance(dataset, str) else None


def _named(dataset: str) -> str | None:
    return None if dataset == DEFAULT_INSTANCE else dataset
