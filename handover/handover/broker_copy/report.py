"""What a copy has done and found, by tenant."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

MAX_LISTED: Final = 10_000
"""Problems that are kept with their words; the others are counted."""

Say = Callable[[str], None]


@dataclass
class Counts:
    """How many entities, or documents of a kind, were found and what became of them."""

    found: int = 0
    created: int = 0
    replaced: int = 0
    present: int = 0
    """In the target before, with the same content."""
    equal: int = 0
    skipped: int = 0
    """Not to be copied: what services of Handover create at their start, and what has expired."""


@dataclass
class TenantReport:
    """The copy of one tenant; `say` prints each problem at once."""

    tenant: str
    say: Say
    entities: Counts = field(default_factory=Counts)
    documents: dict[str, Counts] = field(default_factory=dict)
    contexts: dict[str, str] = field(default_factory=dict)
    """New addresses of hosted @contexts by their old ones."""
    problems: list[dict[str, Any]] = field(default_factory=list)
    problem_count: int = 0
    notes: list[str] = field(default_factory=list)

    @property
    def title(self) -> str:
        """The tenant in words."""
        return f'tenant "{self.tenant}"' if self.tenant else "default tenant"

    @property
    def is_empty(self) -> bool:
        """Whether the source had nothing."""
        return not self.entities.found and not any(counts.found for counts in self.documents.values())

    def problem(self, kind: str, name: str, what: str, **members: Any) -> None:
        """Report what was not copied or differs."""
        self.problem_count += 1
        if len(self.problems) < MAX_LISTED:
            self.problems.append({"kind": kind, "id": name, "problem": what, **members})
        self.say(f"  {kind} {name}: {what}")

    def note(self, text: str) -> None:
        """Report what a person should know and is no fault."""
        self.notes.append(text)
        self.say(f"  {text}")

    def as_json(self) -> dict[str, Any]:
        """Return the report as a JSON object."""
        return {
            "tenant": self.tenant,
            "isEqual": not self.problem_count,
            "entities": vars(self.entities),
            **{name: vars(counts) for name, counts in self.documents.items()},
            "contextAddresses": self.contexts,
            "problemCount": self.problem_count,
            "problems": self.problems,
            "notes": self.notes,
        }
