"""The catalogue of the messages of all services, extracted from their source code.

    python -m handover_web.messages          # write the English texts to app/src/i18n/en/server.json

It consists of all calls `message("code", "template", …)`, of those of a method `translated`, whose
arguments end with both, and of the descriptions of each `AlertType`, a table of templates by code. The
templates are the English texts. The German and Finnish texts are written by hand; a test of the page compares
the languages.
"""

import ast
import json
import string
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[2]
PACKAGES: Final = ("handover", "services", "ros_fiware_bridge", "webui", "datamodels")
ENGLISH: Final = ROOT / "webui" / "app" / "src" / "i18n" / "en" / "server.json"


@dataclass(frozen=True, slots=True)
class FoundMessage:
    """A call of `message` or `translated` in the source, with the names of its parameters."""

    code: str
    template: str
    parameters: frozenset[str]
    location: str


class InvalidMessage(ValueError):
    """A call of `message` that cannot be translated; the text has the location and the reason."""


def found_messages(root: Path = ROOT) -> Iterator[FoundMessage]:
    """Yield every message in the source below `root`; raise `InvalidMessage` for invalid calls."""
    for package in PACKAGES:
        for path in python_sources(root / package):
            yield from _in_module(path.read_text(encoding="utf-8"), path.relative_to(root).as_posix())


def python_sources(folder: Path) -> Iterator[Path]:
    """Yield the Python files below `folder` that are ours and no tests, in the order of their names."""
    for path in sorted(folder.iterdir() if folder.is_dir() else ()):
        if path.is_dir() and path.name not in {"tests", "node_modules", "__pycache__"}:
            yield from python_sources(path)
        elif path.suffix == ".py":
            yield path


def english(messages: Iterator[FoundMessage]) -> dict[str, Any]:
    """Return the English texts in the format of i18next: nested by code, `{{x}}` for `{x}`."""
    texts: dict[str, Any] = {}
    seen: dict[str, FoundMessage] = {}
    for entry in messages:
        before = seen.setdefault(entry.code, entry)
        if before.template != entry.template:
            raise InvalidMessage(
                f"{entry.location}: the code {entry.code} has another text at {before.location}; use one"
            )
        *groups, last = entry.code.split(".")
        parent = texts
        for group in groups:
            parent = parent.setdefault(group, {})
            if not isinstance(parent, dict):
                raise InvalidMessage(
                    f"{entry.location}: {entry.code} begins with a code that is a message itself"
                )
        parent[last] = _i18next_template(entry.template)
    return _sorted(texts)


def _in_module(source: str, location: str) -> Iterator[FoundMessage]:
    if not any(word in source for word in ("message(", ".translated(", "AlertType")):
        return
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Call(func=ast.Name(id="message")):
                yield _found(node, node.args, f"{location}:{node.lineno}")
            case ast.Call(func=ast.Attribute(attr="translated")):
                yield _found(node, node.args[-2:], f"{location}:{node.lineno}")
            case ast.Call(func=ast.Name(id="AlertType"), args=arguments):
                for table in (argument for argument in arguments if isinstance(argument, ast.Dict)):
                    yield from _described(table, f"{location}:{table.lineno}")


def _described(table: ast.Dict, location: str) -> Iterator[FoundMessage]:
    try:
        descriptions: dict[str, str] = ast.literal_eval(table)
    except ValueError:
        raise InvalidMessage(f"{location}: the codes and templates of an Alert are literal strings") from None
    for code, template in descriptions.items():
        names = _placeholders(code, template, location)
        yield FoundMessage(code, template, frozenset(names), location)


def _found(call: ast.Call, arguments: Sequence[ast.expr], location: str) -> FoundMessage:
    texts = [
        argument.value
        for argument in arguments
        if isinstance(argument, ast.Constant) and isinstance(argument.value, str)
    ]
    if len(texts) != 2 or len(arguments) != 2:
        raise InvalidMessage(
            f"{location}: message takes a code and a template, both literal strings, and keyword arguments"
        )
    code, template = texts
    names = {keyword.arg for keyword in call.keywords}
    if None in names:
        raise InvalidMessage(f"{location}: name the parameters of {code} one by one instead of with **")
    for name in _placeholders(code, template, location):
        if name not in names:
            raise InvalidMessage(f"{location}: {code} has no parameter {name}")
    return FoundMessage(code, template, frozenset(name for name in names if name is not None), location)


def _placeholders(code: str, template: str, location: str) -> list[str]:
    """Return the names in a template; raise `InvalidMessage` for what cannot be translated."""
    placeholders = []
    for _, name, form, conversion in string.Formatter().parse(template):
        if name is None:
            continue
        if form or conversion or not name.isidentifier():
            raise InvalidMessage(
                f"{location}: {{{name}}} in {code} must be a plain name; format the value before"
            )
        placeholders.append(name)
    return placeholders


def _i18next_template(template: str) -> str:
    parts = string.Formatter().parse(template)
    return "".join(text + ("" if name is None else f"{{{{{name}}}}}") for text, name, _, _ in parts)


def _sorted(texts: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _sorted(text) if isinstance(text, dict) else text for name, text in sorted(texts.items())}


def serialized(texts: Mapping[str, Any]) -> str:
    """Return the content of the JSON file."""
    return json.dumps(texts, ensure_ascii=False, indent=2) + "\n"


if __name__ == "__main__":
    ENGLISH.write_text(serialized(english(found_messages())), encoding="utf-8")
