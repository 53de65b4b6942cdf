"""Errors for people: they name the thing, the rule and the way out."""

from dataclasses import dataclass
from typing import Any, Self

from handover import messages
from handover.messages import Parameter, with_code


class HandoverError(Exception):
    """The base class of all our errors."""


class TranslatedError(HandoverError):
    """An error whose only argument is its text."""

    @classmethod
    def translated(cls, code: str, template: str, /, **parameters: Parameter) -> Self:
        """Return the error with `handover.messages.message` of these arguments, which the page translates."""
        return cls(messages.message(code, template, **parameters))


class UsageError(HandoverError):
    """An invalid input or setting; shown without a traceback."""


@dataclass
class Problem(HandoverError):
    """An error as HTTP problem details (RFC 7807).

    `type` is a URI (or `about:blank`), `title` the kind of problem, `detail` the correction. The document of
    a `detail` that is a `handover.messages.Message` has its `detailCode` and `detailParameters`.
    """

    status: int
    title: str
    detail: str
    type: str = "about:blank"
    extra: dict[str, Any] | None = None

    @classmethod
    def translated(
        cls, status: int, title: str, code: str, template: str, /, **parameters: Parameter
    ) -> Self:
        """Return the problem with `handover.messages.message` of the last arguments as its detail."""
        return cls(status, title, messages.message(code, template, **parameters))

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


class ChangeMade(Problem):
    """A change was made, and the response to it cannot be: it is recorded as done, and no refusal."""
