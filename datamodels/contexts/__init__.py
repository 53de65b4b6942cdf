"""@contexts: which long name (IRI) each word of the vocabulary stands for.

Those that matter here are shipped, never fetched: our own, the two published ones, the core of NGSI-LD.
"""

from datamodels.contexts.shipped import (
    CORE_URL,
    HANDOVER_URL,
    SHOP4CF_URL,
    SMART_DATA_MODELS_URL,
    handover_context,
    is_core,
    resolve,
)
from datamodels.contexts.term_map import Context, ContextNotAvailable, TermMap, term_map

__all__ = [
    "CORE_URL",
    "HANDOVER_URL",
    "SHOP4CF_URL",
    "SMART_DATA_MODELS_URL",
    "Context",
    "ContextNotAvailable",
    "TermMap",
    "handover_context",
    "is_core",
    "resolve",
    "term_map",
]
