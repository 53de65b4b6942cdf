"""A mapping file on disk: read, checked, and each mistake told with its file, line and key."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from handover.errors import UsageError
from ros_fiware_bridge.mapping import yaml_text
from ros_fiware_bridge.mapping.model import Mapping
from ros_fiware_bridge.mapping.part import keys_of, part_at, unknown
from ros_fiware_bridge.mapping.yaml_text import NotYaml, Where, Written

SHIPPED = Path(__file__).parent.parent / "mappings"
LARGEST_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class Fault:
    """One mistake: the line (from 1), the key, and the rule with the way out."""

    line: int
    key: str
    why: str


class WrongMapping(UsageError):
    """A mapping file cannot be used; `faults` are all mistakes that were found."""

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
    """A mapping with what is needed to speak of its lines."""

    file: str
    mapping: Mapping
    written: Written = field(repr=False)
    folder: Path = Path()

    def fault(self, where: Where, why: str) -> Fault:
        """Return a mistake at the key `where`."""
        return Fault(self.written.line_of(where), _key(where), why)


def load(path: Path) -> Document:
    """Return the mapping in the file at `path`; a bare name is also looked for among the shipped ones.

    Raises `WrongMapping`.
    """
    found = path if path.exists() else SHIPPED / f"{path.name.removesuffix('.yaml')}.yaml"
    if not found.exists():
        shipped = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.yaml")))
        raise UsageError(f"there is no mapping file {path}; those that are shipped are {shipped}")
    try:
        if found.stat().st_size > LARGEST_BYTES:
            raise UsageError(f"the mapping file {path} is larger than {LARGEST_BYTES} bytes; split it in two")
        text = found.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"the mapping file {path} cannot be read: {error}") from None
    return parse(text, str(path) if found is path else found.name, found.parent)


def parse(text: str, file: str = "mapping.yaml", folder: Path = Path()) -> Document:
    """Return the mapping that `text` holds; `file` is how errors call it. Raises `WrongMapping`."""
    try:
        written = yaml_text.read(text)
    except NotYaml as error:
        raise WrongMapping(file, [Fault(error.line, "", str(error))]) from None
    content = {} if written.content is None else written.content
    try:
        mapping = Mapping.model_validate(content)
    except ValidationError as error:
        faults = sorted({_fault(written, dict(one)) for one in error.errors()}, key=lambda one: one.line)
        raise WrongMapping(file, faults) from None
    return Document(file, mapping, written, folder)


def _fault(written: Written, error: dict[str, Any]) -> Fault:
    where: Where = tuple(part for part in error["loc"] if part != "[key]")
    return Fault(written.line_of(where), _key(where), _why(error, where))


def _why(error: dict[str, Any], where: Where) -> str:
    kind, said = error["type"], str(error["msg"])
    if kind == "missing":
        return "this is missing; add it"
    if kind == "value_error":
        return said.removeprefix("Value error, ")
    if kind == "extra_forbidden":
        part = part_at(Mapping, where[:-1])
        return unknown(str(where[-1]), keys_of(part) if part else [])
    if kind == "model_type":
        part = part_at(Mapping, where)
        return f"here stand keys with values: {', '.join(keys_of(part) if part else [])}"
    given = repr(error.get("input"))
    return f"{said[:1].lower()}{said[1:]}; here stands {given[:80]}"


def _key(where: Where) -> str:
    text = ""
    for part in where:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text
