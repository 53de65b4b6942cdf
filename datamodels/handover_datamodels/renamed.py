"""Attributes that had another name before, by entity type.

The old names are terms of core contexts. Services rename stored entities at their start, and the broker
accepts the old names in queries until 1.0.
"""

from collections.abc import Mapping
from typing import Final

from handover_datamodels.contexts.term_map import DEFAULT_VOCAB

_RENAMED: Final = {"PhysiologicalSession": {"start": "startedAt", "end": "endedAt"}}
_IRIS: Final = {
    kind: {DEFAULT_VOCAB + old: DEFAULT_VOCAB + new for old, new in names.items()}
    for kind, names in _RENAMED.items()
}


def renamed_attributes(kind: str) -> Mapping[str, str]:
    """Return the IRIs of renamed attributes by their old IRIs, of an entity type (a name, or its IRI)."""
    return _IRIS.get(kind.removeprefix(DEFAULT_VOCAB), {})
