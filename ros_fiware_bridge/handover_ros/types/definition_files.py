"""Parses `.msg`, `.srv` and `.action` files into definitions.

A `.srv` file defines the messages `X_Request` and `X_Response`; an `.action` file defines `X_Goal`,
`X_Result` and `X_Feedback`. `wrappers.py` derives the messages that transmit them.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from handover_ros.errors import BadDefinition
from handover_ros.types.definition import Definition, Field, FieldType, Many

KINDS = ("msg", "srv", "action")
SECTIONS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}
_NAME = re.compile(r"[A-Z][A-Za-z0-9]*")
_PACKAGE = re.compile(r"[a-z](?:_?[a-z0-9]+)*")


def find(path: Path) -> Iterator[tuple[str, Path]]:
    """Yield (type name, file) for a definition file or every one below a folder.

    A folder may be an ament share folder, a package, or a tree of packages: each file is in a folder `msg`,
    `srv` or `action` inside the folder with the name of its package.

    Raises:
        BadDefinition: the path does not exist, contains no definition, or a file is not in a package.
    """
    if not path.exists():
        raise BadDefinition(f"type_paths: {path} does not exist; name a definition file or a folder of them")
    if path.is_file():
        yield _named(path), path
        return
    is_present = False
    for kind in KINDS:
        for file in sorted(path.rglob(f"*.{kind}")):
            if file.parent.name == kind:
                is_present = True
                yield _named(file), file
    if not is_present:
        raise BadDefinition(
            f"type_paths: {path} contains no definition; the layout is PACKAGE/msg/NAME.msg, "
            "PACKAGE/srv/NAME.srv or PACKAGE/action/NAME.action"
        )


def _named(file: Path) -> str:
    kind = file.suffix.removeprefix(".")
    package = file.resolve().parent.parent.name
    if kind not in KINDS or file.resolve().parent.name != kind:
        raise BadDefinition(
            f"{file} is not in a package; move it to PACKAGE/msg/NAME.msg, PACKAGE/srv/NAME.srv or "
            "PACKAGE/action/NAME.action"
        )
    if not _PACKAGE.fullmatch(package):
        raise BadDefinition(
            f'{file}: "{package}" cannot be a ROS package; use a-z, digits and single underscores'
        )
    if not _NAME.fullmatch(file.stem):
        raise BadDefinition(
            f'{file}: "{file.stem}" cannot be a ROS type; use a capital first, then A-Z, a-z and 0-9'
        )
    return f"{package}/{kind}/{file.stem}"


def read(type_name: str, file: Path) -> list[Definition]:
    """Return the definitions in a file.

    Raises:
        BadDefinition: the error names the file and the line.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadDefinition(f"{file} cannot be read: {error}") from error
    return parse(type_name, text, str(file))


def parse(type_name: str, text: str, where: str) -> list[Definition]:
    """Return the definitions in the text of a file; `where` names the file in errors."""
    package, kind, name = type_name.split("/")
    suffixes = SECTIONS[kind]
    lines = text.splitlines()
    cuts = [number for number, line in enumerate(lines) if line.strip() == "---"]
    if len(cuts) != len(suffixes) - 1:
        raise BadDefinition(
            f"{where}: a .{kind} file has {len(suffixes)} parts, with {len(suffixes) - 1} lines of --- "
            f"between them; this file has {len(cuts)} such lines"
        )
    starts = [0, *(cut + 1 for cut in cuts)]
    ends = [*cuts, len(lines)]
    return [
        _definition(f"{package}/{kind}/{name}{suffix}", package, lines[start:end], where, start)
        for suffix, start, end in zip(suffixes, starts, ends, strict=True)
    ]


def _definition(type_name: str, package: str, lines: list[str], where: str, offset: int) -> Definition:
    from rosbags.typesys.base import TypesysError  # noqa: PLC0415 - heavy, and needed for custom types alone
    from rosbags.typesys.msg import MSGParser  # noqa: PLC0415

    fields: list[Field] = []
    constants: dict[str, object] = {}
    for number, line in enumerate(lines, start=offset + 1):
        bare = line.strip()
        if not bare or bare.startswith(("#", "@")):
            continue
        is_wide = re.match(r"wstring\b", bare) is not None
        try:
            # The parser knows no wstring, which is written as a string is.
            plain = bare.removeprefix("w") if is_wide else bare
            message = MSGParser(f"MSG: {package}/msg/Line\n{plain}\n").specification()[0]
        except TypesysError:
            raise BadDefinition(
                f'{where}, line {number}: "{bare}" is not a field (TYPE NAME), a field with a default '
                "(TYPE NAME VALUE) or a constant (TYPE NAME=VALUE)"
            ) from None
        for constant in message.constants:
            constants[constant.name] = _bare(constant.value)
        for field in message.fields:
            if any(field.name == other.name for other in fields):
                raise BadDefinition(f'{where}, line {number}: the field "{field.name}" is a duplicate')
            cardinality = {"scalar": Many.ONE, "array": Many.FIXED, "sequence": Many.SEQUENCE}
            base = "wstring" if is_wide else str(getattr(field.typ.ref.name, "value", field.typ.ref.name))
            many = cardinality[field.typ.cardinality.value]
            if many is Many.FIXED and field.typ.size < 1:
                raise BadDefinition(f'{where}, line {number}: "{bare}" has an array without elements')
            kind = FieldType(base, many, field.typ.size, field.typ.str_size)
            fields.append(Field(field.name, kind, _bare(field.value)))
    return Definition(type_name, tuple(fields), constants)


def _bare(value: object) -> object:
    """Return a default or constant without the backslashes before quotes."""
    if isinstance(value, list):
        return [_bare(element) for element in value]
    return re.sub(r"\\(['\"])", r"\1", value) if isinstance(value, str) else value
