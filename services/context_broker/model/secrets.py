"""Secrets in subscriptions, registrations and snapshots: what a client writes and nobody reads.

They are the values of `receiverInfo`, `notifierInfo` and `contextSourceInfo`, and in addresses the user
information and the values of the query. Responses, notifications about registrations, logs and audit records
show `HIDDEN` instead. A client that sends `HIDDEN` back keeps the stored value, as long as the address is the
same: so a document that was read can be changed and written, and no secret follows a change of the address.
"""

import re
from collections.abc import Mapping
from typing import Any, Final

from handover.settings import PASSWORD_IN_URL, STARS

HIDDEN: Final = STARS
PAIRS: Final = ("receiverInfo", "notifierInfo", "contextSourceInfo")
_QUERY_VALUE: Final = re.compile(r"([?&;][^=&;#]*=)[^&;#]+")
_PLAIN_VALUES: Final = frozenset({"urn:ngsi-ld:request"})
_PLAIN_KEYS: Final = frozenset(
    {
        "jsonldcontext",
        "accept",
        "contenttype",
        "content-type",
        "ngsildconformance",
        "mqtt-qos",
        "mqtt-version",
    }
)
"""Keys whose values the broker itself evaluates; they are no secrets."""


def without_secrets(uri: str) -> str:
    """Return an address without passwords and values of its query."""
    return _QUERY_VALUE.sub(rf"\1{HIDDEN}", PASSWORD_IN_URL.sub(rf"\1{HIDDEN}@", uri))


def shown_pairs(pairs: Any) -> Any:
    """Return a list of keys and values with the secret values hidden."""
    if not isinstance(pairs, list):
        return pairs
    return [
        {**pair, "value": HIDDEN}
        if isinstance(pair, Mapping) and "value" in pair and _is_secret(pair)
        else pair
        for pair in pairs
    ]


def shown_members(document: Mapping[str, Any], address: str) -> dict[str, Any]:
    """Return an object with its secrets hidden; `address` is the member with the address."""
    shown = {name: shown_pairs(value) if name in PAIRS else value for name, value in document.items()}
    if isinstance(shown.get(address), str):
        shown[address] = without_secrets(shown[address])
    return shown


def _is_secret(pair: Mapping[str, Any]) -> bool:
    key, value = pair.get("key"), pair.get("value")
    return value not in _PLAIN_VALUES and not (isinstance(key, str) and key.lower() in _PLAIN_KEYS)
