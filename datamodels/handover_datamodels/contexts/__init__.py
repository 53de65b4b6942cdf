"""@contexts: the IRIs of the terms of the vocabulary.

The relevant contexts are shipped, never fetched: our own, the two published ones, and the NGSI-LD core.
"""

from handover_datamodels.contexts.shipped import (
    CORE_EXCEPTIONS,
    CORE_MINORS,
    CORE_URL,
    HANDOVER_URL,
    SHOP4CF_URL,
    SMART_DATA_MODELS_URL,
    core_terms,
    handover_context,
    is_core,
    resolve,
)
from handover_datamodels.contexts.term_map import Context, ContextNotAvailable, TermMap, term_map

__all__ = [
    "CORE_EXCEPTIONS",
    "CORE_MINORS",
    "CORE_URL",
    "HANDOVER_URL",
    "SHOP4CF_URL",
    "SMART_DATA_MODELS_URL",
    "Context",
    "ContextNotAvailable",
    "TermMap",
    "core_terms",
    "handover_context",
    "is_core",
    "resolve",
    "term_map",
]
