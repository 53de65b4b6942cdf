"""The messages of all services, found in their source: what the page must have words for.

    python -m webui.messages          # write the English ones to app/src/i18n/en/server.json

Found are calls of `message("code", "template", …)`. The templates of the source are the English texts; German
and Finnish are written by hand beside them, and a test of the page compares the languages.
"""

import ast
import json
import string
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parent.parent
PACKAGES: Final = ("handover", "services", "ros_fiware_bridge", "webui", "datamodels")
ENGLISH: Final = ROOT / "webui" / "app" / "src" / "i18n" / "en" / "server.json"


@dataclass(frozen=True, slots=True)
class Found:
    """A call of `message` in the source, and the names of the parameters that it passes."""

    code: str
    template: str
    parameters: frozenset[str]
    where: str


class WrongMessage(ValueError):
    """A call of `message` that no translation can be made for; the text says where and why."""


def found_messages(root: Path = ROOT) -> Iterator[Found]:
    """Yield every message in the source below `root`; raise `WrongMessage` for what cannot be translated."""
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            if "node_modules" not in path.parts:
                yield from _in_module(path.read_text(encoding="utf-8"), path.relative_to(root).as_posix())


def english(found: Iterator[Found]) -> dict[str, Any]:
    """Return the English texts as the page has them: nested by their codes, `{{x}}` for `{x}`."""
    texts: dict[str, Any] = {}
    known: dict[str, Found] = {}
    for one in found:
        before = known.setdefault(one.code, one)
        if before.template != one.template:
            raise WrongMessage(
                f"{one.where}: the code {one.code} has another text at {before.where}; use one"
            )
        *groups, last = one.code.split(".")
        place = texts
        for group in groups:
            place = place.setdefault(group, {})
            if not isinstance(place, dict):
                raise WrongMessage(f"{one.where}: {one.code} begins with a code that is a message itself")
        place[last] = _as_on_the_page(one.template)
    return _sorted(texts)


def _in_module(source: str, where: str) -> Iterator[Found]:
    if "message(" not in source:
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "message":
            yield _found(node, f"{where}:{node.lineno}")


def _found(call: ast.Call, where: str) -> Found:
    texts = [one.value for one in call.args if isinstance(one, ast.Constant) and isinstance(one.value, str)]
    if len(texts) != 2 or len(call.args) != 2:
        raise WrongMessage(f"{where}: message has a code and a template, both literal text, and keywords")
    code, template = texts
    names = {keyword.arg for keyword in call.keywords}
    if None in names:
        raise WrongMessage(f"{where}: name the parameters of {code} one by one instead of with **")
    for _, name, form, conversion in string.Formatter().parse(template):
        if name is not None and (form or conversion or not name.isidentifier()):
            raise WrongMessage(f"{where}: {{{name}}} in {code} must be a plain name; format the value before")
        if name is not None and name not in names:
            raise WrongMessage(f"{where}: {code} has no parameter {name}")
    return Found(code, template, frozenset(name for name in names if name is not None), where)


def _as_on_the_page(template: str) -> str:
    parts = string.Formatter().parse(template)
    return "".join(text + ("" if name is None else f"{{{{{name}}}}}") for text, name, _, _ in parts)


def _sorted(texts: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _sorted(text) if isinstance(text, dict) else text for name, text in sorted(texts.items())}


def written(texts: Mapping[str, Any]) -> str:
    """Return texts as the file that the page loads."""
    return json.dumps(texts, ensure_ascii=False, indent=2) + "\n"


if __name__ == "__main__":
    ENGLISH.write_text(written(english(found_messages())), encoding="utf-8")
