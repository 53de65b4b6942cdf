"""Messages for people: English text with a code and parameters, so that the page can translate it.

    message("glove.unknown", 'there is no glove "{glove}"', glove=name)
    raise Problem.translated(404, "Unknown glove", "glove.unknown", 'there is no glove "{glove}"', glove=name)

A `Message` is a string: logs, command lines and clients that ignore codes use its English text. In JSON,
`with_code` adds the code and the parameters beside the text. Codes are an API: a code keeps its meaning, and
the page has a translation for each (`webui/app/src/i18n/*/server.json`). The module `handover_web.messages`
finds the codes in the source, and a test compares them.
"""

import math
from collections.abc import Mapping
from typing import Any, Self

Parameter = str | int | float | bool | None
"""The type of a parameter; a `Message` may be a parameter of another one."""


class Message(str):
    """An English text made from a template, with the `code` of the template and its `parameters`."""

    __slots__ = ("code", "parameters")

    code: str
    parameters: Mapping[str, Any]

    def __new__(cls, text: str, code: str, parameters: Mapping[str, Any]) -> Self:
        """Return `text` as the message of `code`; `message` makes one from a template."""
        made = super().__new__(cls, text)
        made.code = code
        made.parameters = parameters
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.code, dict(self.parameters))


def message(code: str, template: str, /, **parameters: Parameter) -> Message:
    """Return the message of `template` (as for `str.format`) with these parameters.

    Numbers with a fraction are rounded for people; see `readable`.
    """
    shown = {
        name: readable(value) if isinstance(value, float) else value for name, value in parameters.items()
    }
    return Message(template.format_map(shown), code, shown)


def readable(value: float) -> float | int:
    """Return a number as people read it: with four significant digits, whole from a thousand on."""
    if not math.isfinite(value):
        return value
    whole = round(value)
    if value == whole or abs(value) >= 1000:
        return whole
    return float(f"{value:.4g}")


def number_text(value: float | None) -> str:
    """Return the text of `readable`, for an English text without a code; "none" for None."""
    return "none" if value is None else str(readable(value))


def text_of(error: BaseException) -> str:
    """Return the text of an error, as a `Message` if it was raised with one."""
    first = error.args[0] if error.args else None
    return first if isinstance(first, Message) else str(error)


def with_code(name: str, text: str) -> dict[str, Any]:
    """Return `text` as the JSON member `name`; a `Message` with `<name>Code` and `<name>Parameters`."""
    members: dict[str, Any] = {name: str(text)}
    if isinstance(text, Message):
        members[f"{name}Code"] = text.code
        members[f"{name}Parameters"] = {key: _as_json(value) for key, value in text.parameters.items()}
    return members


def message_in(members: Mapping[str, Any], name: str) -> str | None:
    """Return the text that `with_code` wrote, as a `Message` if it has a code; None without a text.

    The members come from another service, so members of other types are ignored.
    """
    text = members.get(name)
    if not isinstance(text, str):
        return None
    code, parameters = members.get(f"{name}Code"), members.get(f"{name}Parameters")
    if not isinstance(code, str) or not isinstance(parameters, Mapping):
        return text
    return Message(text, code, {str(key): _from_json(value) for key, value in parameters.items()})


def _as_json(value: Any) -> Any:
    if isinstance(value, Message):
        return with_code("text", value)
    return value


def _from_json(value: Any) -> Any:
    return message_in(value, "text") if isinstance(value, Mapping) else value
