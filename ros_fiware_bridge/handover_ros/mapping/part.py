"""The base class of all parts of a mapping file, and the types of their values."""

from collections.abc import Sequence
from difflib import get_close_matches
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict

from handover_ros.mapping import names, paths, templates
from handover_ros.mapping.paths import Path
from handover_ros.mapping.templates import Template


class Part(BaseModel):
    """A part of a mapping file; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False)


def keys_of(part: type[Part]) -> list[str]:
    """Return the keys of `part`, as they are written in a file."""
    return [field.alias or name for name, field in part.model_fields.items()]


def part_at(top: type[Part], where: Sequence[str | int]) -> type[Part] | None:
    """Return the class of the part at `where` in a file whose class is `top`; None if it has none."""
    here: Any = top
    for step in where:
        if isinstance(here, type) and issubclass(here, Part):
            names = {field.alias or name: field.annotation for name, field in here.model_fields.items()}
            here = names.get(str(step))
        else:
            arguments = get_args(here)
            here = arguments[-1] if arguments else None
        here = _without_wrapping(here)
    return here if isinstance(here, type) and issubclass(here, Part) else None


def _without_wrapping(annotation: Any) -> Any:
    """Return `X` of `Annotated[X, …]` and of `X | None`."""
    while (kind := get_origin(annotation)) in {Annotated, Union, UnionType}:
        choices = [choice for choice in get_args(annotation) if choice is not NoneType]
        annotation = choices[0]
        if kind is not Annotated and len(choices) > 1:
            break
    return annotation


def unknown(word: str, words: Sequence[str]) -> str:
    """Return the error text for a word that is not in `known`."""
    close = get_close_matches(word, words, n=1)
    meant = f'did you mean "{close[0]}"?' if close else f"use one of {', '.join(words)}"
    return f'"{word}" is unknown here; {meant}'


def _path(written: Any) -> Path:
    return (
        written
        if isinstance(written, Path)
        else paths.parse(str(written) if isinstance(written, str) else "")
    )


def _template(written: Any) -> Template:
    if isinstance(written, Template):
        return written
    if not isinstance(written, str | int) or isinstance(written, bool):
        raise ValueError("text is expected, such as Device:ur10-1 or Device:{header.frame_id}")  # noqa: TRY004
    return templates.parse(str(written))


def _type_in(kind: names.Kind) -> AfterValidator:
    return AfterValidator(lambda text: names.type_name(text, kind))


PathText = Annotated[Path, BeforeValidator(_path)]
TemplateText = Annotated[Template, BeforeValidator(_template)]
TopicName = Annotated[str, AfterValidator(names.topic)]
TopicPattern = Annotated[str, AfterValidator(names.topic_pattern)]
MessageType = Annotated[str, _type_in("msg")]
ServiceType = Annotated[str, _type_in("srv")]
ActionType = Annotated[str, _type_in("action")]
Plain = bool | int | float | str

QosWord = Literal["match", "default", "sensor_data", "services", "latched"]


def short_form(key: str) -> BeforeValidator:
    """Return a validator that accepts a bare word for `{key: word}`."""

    def expanded(written: Any) -> Any:
        return (
            {key: written}
            if isinstance(written, str | int | float) and not isinstance(written, bool)
            else written
        )

    return BeforeValidator(expanded)
