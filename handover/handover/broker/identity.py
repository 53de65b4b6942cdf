"""Which broker answers: the embedded one, or another one by the version that it says.

What brokers do differently is decided by this, and never tried on entities of people: some keep damage.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

ORION_VERSION_PATH: Final = "/ngsi-ld/ex/v1/version"
CONTEXT_PATH: Final = "/context.jsonld"
"""Where each server of ours has our @context, for everybody."""
_OUR_NAME: Final = "Handover"
_OUR_TERMS: Final = frozenset({"Task", "HumanState", "PhysiologicalSession"})


@dataclass(frozen=True, slots=True)
class BrokerIdentity:
    """A broker by name and version, which are empty where it does not say them."""

    name: str = ""
    version: str = ""

    @property
    def is_ours(self) -> bool:
        """Whether it is the embedded broker, of whatever version."""
        return self.name == _OUR_NAME

    @property
    def keeps_instances(self) -> bool:
        """Whether a batch may have attributes with several instances (`datasetId`).

        Orion-LD 1.6 refuses or damages such an entity; of a broker that is not known it is not assumed.
        """
        return self.is_ours


OURS: Final = BrokerIdentity(_OUR_NAME)


def is_our_context(document: Any) -> bool:
    """Return whether the document at `CONTEXT_PATH` is our @context, of whatever version."""
    terms = document.get("@context") if isinstance(document, Mapping) else None
    return isinstance(terms, Mapping) and terms.keys() >= _OUR_TERMS


def identity_in(orion_version: Any) -> BrokerIdentity:
    """Return the broker of others that has this document at `ORION_VERSION_PATH`."""
    if isinstance(orion_version, Mapping):
        versions = {str(key).lower().replace("-", ""): str(value) for key, value in orion_version.items()}
        if "orionld version" in versions:
            return BrokerIdentity("Orion-LD", versions["orionld version"])
    return BrokerIdentity()
