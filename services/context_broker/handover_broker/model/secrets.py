"""Secrets in subscriptions, registrations and snapshots: what a client writes and nobody reads.

They are the values of `receiverInfo`, `notifierInfo` and `contextSourceInfo`, and in addresses the user
information, the values of the query, the fragment, and parts of the path that look like a key. Responses,
notifications about registrations, logs and audit records show `HIDDEN` instead.

A client that sends `HIDDEN` back keeps the stored value, so that it can change a document that it has read.
No secret follows a change of the address: then the values are to be given again.
"""

import re
from collections.abc import Mapping
from typing import Any, Final

from handover.settings import STARS
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import shown

HIDDEN: Final = STARS
_PARTS: Final = re.compile(r"([^/?#]*//[^/?#]*)?([^?#]*)(\?[^#]*)?(#.*)?", re.DOTALL)
"""The parts of any address: scheme and authority, path, query, fragment."""
_USER_INFORMATION: Final = re.compile(r"//.*@", re.DOTALL)
_QUERY_VALUE: Final = re.compile(r"([?&;])([^=&;]*=)?[^&;]+")
_KEY_IN_PATH: Final = re.compile(r"(?<![^/])(?!urn:)(?=[^/]*[0-9])(?=[^/]*[A-Za-z])[^/]{20,}")
_FROM_THE_REQUEST: Final = "urn:ngsi-ld:request"
_PLAIN_KEYS: Final = frozenset(
    {"jsonldcontext", "accept", "contenttype", "ngsildconformance", "mqtt-qos", "mqtt-version", "prefer"}
)
"""Keys whose values the broker itself evaluates; they are no secrets."""


def without_secrets(uri: str) -> str:
    """Return an address without user information, values of its query, keys in its path, and fragment."""
    parts = _PARTS.fullmatch(uri)
    assert parts is not None  # noqa: S101 - each part may be empty
    authority, path, query, fragment = (text or "" for text in parts.groups())
    authority = _USER_INFORMATION.sub(f"//{HIDDEN}@", authority)
    query = _QUERY_VALUE.sub(lambda value: f"{value[1]}{value[2] or ''}{HIDDEN}", query)
    return authority + _KEY_IN_PATH.sub(HIDDEN, path) + query + (f"#{HIDDEN}" if fragment else "")


def hidden_members(document: Mapping[str, Any], address: str, *pairs: str) -> dict[str, Any]:
    """Return an object with its secrets hidden: in the member `address`, and in lists of keys and values."""
    hidden = {name: _hidden_pairs(value) if name in pairs else value for name, value in document.items()}
    if isinstance(hidden.get(address), str):
        hidden[address] = without_secrets(hidden[address])
    return hidden


def kept_members(
    replacement: Mapping[str, Any], before: Mapping[str, Any], address: str, *pairs: str
) -> dict[str, Any]:
    """Return an object that replaces `before`, with the stored values where it has `HIDDEN`.

    Raises a problem (400) if there is no such value, or the address is another one.
    """
    after, stored = dict(replacement), before.get(address)
    uri = replacement.get(address)
    if isinstance(uri, str) and HIDDEN in uri:
        if not isinstance(stored, str) or without_secrets(stored) != uri:
            raise bad_request_data(
                f'"{address}" {shown(uri)} has {HIDDEN} in place of a secret; give the whole address'
            )
        after[address] = stored
    for name in pairs:
        if isinstance(replacement.get(name), list):
            pairs_before = before.get(name) if after.get(address) == stored else None
            after[name] = [_kept_pair(pair, pairs_before, name) for pair in replacement[name]]
    return after


def require_secrets_again(
    after: Mapping[str, Any], before: Mapping[str, Any], change: Mapping[str, Any], address: str, name: str
) -> None:
    """Raise a problem (400) if a change of the address would send stored secrets to the new one."""
    secrets = [pair for pair in before.get(name) or () if isinstance(pair, Mapping) and _is_secret(pair)]
    if secrets and name not in change and after.get(address) != before.get(address):
        raise bad_request_data(
            f'a change of "{address}" needs "{name}" as well, because its values are not sent to another '
            "address; give them again, or null to delete them"
        )


def _kept_pair(pair: Any, stored: Any, name: str) -> Any:
    if not isinstance(pair, Mapping) or pair.get("value") != HIDDEN:
        return pair
    for other in stored if isinstance(stored, list) else ():
        if isinstance(other, Mapping) and other.get("key") == pair.get("key"):
            return {**pair, "value": other.get("value")}
    raise bad_request_data(
        f"{name} {shown(pair.get('key'))} has {HIDDEN} in place of its value, and there is no stored value "
        "for this address; give the value"
    )


def _hidden_pairs(pairs: Any) -> Any:
    if not isinstance(pairs, list):
        return pairs
    return [
        {**pair, "value": HIDDEN} if isinstance(pair, Mapping) and _is_secret(pair) else pair
        for pair in pairs
    ]


def _is_secret(pair: Mapping[str, Any]) -> bool:
    key, value = pair.get("key"), pair.get("value")
    return value != _FROM_THE_REQUEST and not (isinstance(key, str) and key.lower() in _PLAIN_KEYS)
