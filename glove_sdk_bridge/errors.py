"""Errors, with messages for the person who wears the glove."""

from collections import Counter
from collections.abc import Callable

Say = Callable[[str], None]


class BridgeError(Exception):
    """The command failed; the message is one line that names the thing, the rule and the remedy."""


class BadLine(ValueError):
    """A line is no valid frame; `rule` is one of a few fixed texts, used for counting."""

    def __init__(self, rule: str) -> None:
        super().__init__(rule)
        self.rule = rule


class Dropped:
    """Counts invalid lines; only the first of each kind is reported."""

    def __init__(self, where: str, say: Say) -> None:
        self.by_rule: Counter[str] = Counter()
        self._where = where
        self._say = say

    def __len__(self) -> int:
        return self.by_rule.total()

    def add(self, rule: str, line: bytes | str) -> None:
        """Count `line`, which breaks `rule`."""
        self.by_rule[rule] += 1
        if self.by_rule[rule] == 1:
            shown = line[:60] if isinstance(line, str) else line[:60].decode("utf-8", "replace")
            self._say(
                f"{self._where}: a line is dropped: {rule}: {shown!r}; more of the kind are only counted"
            )
