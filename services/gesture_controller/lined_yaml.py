"""Lined YAML: a file that people write, read so that every mistake names the file and the line.

Values stay as they are written: the types of YAML would read the code 02222 as the number 1170.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import yaml

from handover.errors import UsageError


class WrongFile(UsageError):
    """A file cannot be used; the message says where, why and what to do."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A key and its value, as written."""

    key: str
    line: int
    value: yaml.Node


class LinedYaml:
    """Reads the file called `name`; raises `mistake` for what cannot be read."""

    mistake: type[WrongFile] = WrongFile

    def __init__(self, name: str) -> None:
        self.name = name

    def compose(self, text: str) -> yaml.Node | None:
        """Return what `text` holds, None if it is empty."""
        try:
            return yaml.compose(text, Loader=yaml.SafeLoader)
        except yaml.YAMLError as error:
            where = getattr(error, "problem_mark", None)
            line = f":{where.line + 1}" if where else ""
            problem = getattr(error, "problem", None) or str(error)
            raise self.mistake(f"{self.name}{line}: not YAML: {problem}") from None
        except RecursionError:
            raise self.mistake(f"{self.name}: nested too deeply; write names and values") from None

    def entries(self, node: yaml.Node, what: str) -> list[Entry]:
        """Return the names and values in `node`; each name stands once."""
        if not isinstance(node, yaml.MappingNode):
            raise self.wrong(line_of(node), f'{what} must be names with values ("name: value" lines)')
        entries: dict[str, Entry] = {}
        for entry in self._pairs(node, what):
            if entry.key in entries:
                raise self.wrong(
                    entry.line,
                    f'"{entry.key}" stands twice in {what}, first in line {entries[entry.key].line}; '
                    "remove or rename one of them",
                )
            entries[entry.key] = entry
        return list(entries.values())

    def _pairs(self, node: yaml.MappingNode, what: str) -> Iterator[Entry]:
        for key, value in node.value:
            yield Entry(self.text(key, f"a name in {what}"), line_of(key), value)

    def text(self, node: yaml.Node, what: str) -> str:
        """Return a word or a number as it is written."""
        if not isinstance(node, yaml.ScalarNode) or not node.value.strip():
            raise self.wrong(line_of(node), f"{what} must be a word or a number")
        return str(node.value)

    def number(self, entry: Entry, what: str) -> float:
        """Return a number."""
        text = self.text(entry.value, what)
        try:
            return float(text)
        except ValueError:
            raise self.wrong(entry.line, f'{what} must be a number, not "{text}"') from None

    def wrong(self, line: int, why: str) -> WrongFile:
        """Return the mistake in `line`."""
        return self.mistake(f"{self.name}:{line}: {why}")


def line_of(node: yaml.Node) -> int:
    """Return the line in which `node` begins, from 1."""
    return int(node.start_mark.line) + 1


def is_empty(node: yaml.Node) -> bool:
    """Say whether nothing stands there."""
    return isinstance(node, yaml.ScalarNode) and not node.value.strip()
