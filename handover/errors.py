"""Errors that a person is meant to read: they name the thing, the rule and the way out."""

from dataclasses import dataclass
from typing import Any

from handover.messages import with_code


class HandoverError(Exception):
    """The root of all errors of ours."""


class UsageError(HandoverError):
    """Something a person typed or configured cannot be used; shown without a traceback."""


@dataclass
class Problem(HandoverError):
    """An error as it travels over HTTP (RFC 7807 problem details).

    `type` is a URI (or `about:blank`), `title` the kind of problem, `detail` what to change. A `detail` that
    is a `handover.messages.Message` travels with its `detailCode` and `detailParameters`.
    """

    status: int
    title: str
    detail: str
    type: str = "about:blank"
    extra: dict[str, Any] | None = None

    def __str__(self) -> str:
        return f"{self.title}: {self.detail}" if self.detail else self.title

    def body(self) -> dict[str, Any]:
        """Return the problem details document."""
        return {
            "type": self.type,
            "title": self.title,
            "status": self.status,
            **with_code("detail", self.detail),
            **(self.extra or {}),
        }
