"""What can go wrong with a glove, in words for the person who wears it."""

from collections import Counter
from collections.abc import Callable

Say = Callable[[str], None]


class BridgeError(Exception):
    """Nothing can go on; the message is one line that names the thing, the rule and the way out."""


class BadLine(ValueError):
    """A line is no frame; `rule` says in a few words what it lacks, fit to count by."""

    def __init__(self, rule: str) -> None:
        super().__init__(rule)
        self.rule = rule


class Dropped:
    """Counts the lines that were no frames; the first of each kind is said aloud, the rest only counted."""

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
