"""Loads and validates a mapping file; each error has its file, line and key."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from handover.errors import UsageError
from handover_ros.mapping import yaml_text
from handover_ros.mapping.model import Mapping
from handover_ros.mapping.part import keys_of, part_at, unknown
from handover_ros.mapping.yaml_text import NotYaml, Where, Written

SHIPPED = Path(__file__).parent.parent / "mappings"
MAX_FILE_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class Fault:
    """One error: the line (from 1), the key, and the rule with the way out."""

    line: int
    key: str
    why: str


class InvalidMapping(UsageError):
    """A mapping file cannot be used; `faults` are all errors found."""

    def __init__(self, file: str, faults: Iterable[Fault]) -> None:
        self.file = file
        self.faults = tuple(faults)
        super().__init__(
            "\n".join(
                f"{file}:{fault.line}: {fault.key}: {fault.why}"
                if fault.key
                else f"{file}:{fault.line}: {fault.why}"
                for fault in self.faults
            )
        )


@dataclass(frozen=True)
class Document:
    """A mapping and the line numbers of its keys."""

    file: str
    mapping: Mapping
    written: Written = field(repr=False)
    folder: Path = Path()

    def fault(self, where: Where, why: str) -> Fault:
        """Return an error at the key `where`."""
        return Fault(self.written.line_of(where), _key(where), why)


def load(path: Path) -> Document:
    """Return the mapping in the file at `path`; a bare name also selects a shipped mapping.

    Raises `InvalidMapping`.
    """
    mapping_file = path if path.exists() else SHIPPED / f"{path.name.removesuffix('.yaml')}.yaml"
    if not mapping_file.exists():
        shipped = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.yaml")))
        raise UsageError(f"there is no mapping file {path}; the shipped mappings are {shipped}")
    try:
        if mapping_file.stat().st_size > MAX_FILE_BYTES:
            raise UsageError(
                f"the mapping file {path} is larger than {MAX_FILE_BYTES} bytes; split it in two"
            )
        text = mapping_file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"the mapping file {path} cannot be read: {error}") from None
    return parse(text, str(path) if mapping_file is path else mapping_file.name, mapping_file.parent)


def parse(text: str, file: str = "mapping.yaml", folder: Path = Path()) -> Document:
    """Return the mapping in `text`; `file` names it in errors. Raises `InvalidMapping`."""
    try:
        written = yaml_text.read(text)
    except NotYaml as error:
        raise InvalidMapping(file, [Fault(error.line, "", str(error))]) from None
    content = {} if written.content is None else written.content
    try:
        mapping = Mapping.model_validate(content)
    except ValidationError as error:
        faults = sorted(
            {_fault(written, dict(detail)) for detail in error.errors()}, key=lambda detail: detail.line
        )
        raise InvalidMapping(file, faults) from None
    return Document(file, mapping, written, folder)


def _fault(written: Written, error: dict[str, Any]) -> Fault:
    where: Where = tuple(part for part in error["loc"] if part != "[key]")
    return Fault(written.line_of(where), _key(where), _why(error, where))


def _why(error: dict[str, Any], where: Where) -> str:
    kind, reason = error["type"], str(error["msg"])
    if kind == "missing":
        return "this key is missing; add it"
    if kind == "value_error":
        return reason.removeprefix("Value error, ")
    if kind == "extra_forbidden":
        part = part_at(Mapping, where[:-1])
        return unknown(str(where[-1]), keys_of(part) if part else [])
    if kind == "model_type":
        part = part_at(Mapping, where)
        return f"a mapping with these keys is expected: {', '.join(keys_of(part) if part else [])}"
    text = repr(error.get("input"))
    return f"{reason[:1].lower()}{reason[1:]}; the value is {text[:80]}"


def _key(where: Where) -> str:
    text = ""
    for part in where:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text
