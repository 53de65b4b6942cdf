"""A rule as in REST responses. The page's TypeScript types are generated from it."""

from typing import Any, NotRequired

from typing_extensions import TypedDict

RuleView = TypedDict(
    "RuleView",
    {
        "name": str,
        "section": str,
        "enabled": bool,
        "received": int,
        "receivedPerS": float,
        "forwarded": int,
        "forwardedPerS": float,
        "dropped": int,
        "droppedByCause": dict[str, int],
        "conflated": int,
        "errors": int,
        "lastValue": Any,
        "lastError": str | None,
        "lastErrorAt": str | None,
        "from": str | None,
        "to": str | None,
        "type": str | None,
        "qos": NotRequired[str],
        "publishers": NotRequired[int],
        "subscribers": NotRequired[int],
        "unreadable": NotRequired[int],
        "lastUnreadable": NotRequired[str | None],
        "topics": NotRequired[list[str]],
    },
)
"""The statistics of a rule, with its source, target and peers.

Only a rule that subscribes to a topic has `publishers`, `unreadable` and `lastUnreadable`.
"""
