"""form-js, the format of the forms of Camunda: read, resolved into fields for the present data, and checked.

A component may be hidden by a condition, and labels, limits and options may be FEEL expressions over the
data. They are evaluated here, never on the page: `resolve` returns the fields for the data, and the page asks
again when a value changes. `check` uses the same fields, so page and server cannot disagree.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import orjson

from handover.errors import Problem
from handover.messages import Message, message, with_code
from handover_bpmn.forms.fields import (
    MAX_DEPTH,
    MAX_FIELDS,
    MAX_LIST_ITEMS,
    WITHOUT_VALUE,
    Field,
    FieldFault,
    FieldKind,
    Option,
    has_value,
    put_at,
    value_at,
    value_fault,
)
from handover_bpmn.languages.base import ExpressionError, Json
from handover_bpmn.languages.feel import read_feel

MAX_FORM_BYTES = 512 * 1024

_TEMPLATE = re.compile(r"\{\{([^{}]{1,1000})\}\}")
_PATH = re.compile(r"[A-Za-z_$][\w$]*(\.[A-Za-z_$][\w$]*){0,9}", re.ASCII)
_TAGS = re.compile(r"<[^<>]*>")

_KINDS: Mapping[str, FieldKind] = {
    "textfield": FieldKind.TEXT,
    "textarea": FieldKind.MULTILINE,
    "number": FieldKind.NUMBER,
    "checkbox": FieldKind.BOOLEAN,
    "checklist": FieldKind.CHOICES,
    "taglist": FieldKind.CHOICES,
    "radio": FieldKind.CHOICE,
    "select": FieldKind.CHOICE,
    "datetime": FieldKind.DATETIME,
    "expression": FieldKind.COMPUTED,
    "group": FieldKind.GROUP,
    "dynamiclist": FieldKind.LIST,
    "text": FieldKind.NOTE,
    "html": FieldKind.NOTE,
    "image": FieldKind.IMAGE,
    "iframe": FieldKind.LINK,
    "table": FieldKind.TABLE,
    "separator": FieldKind.SEPARATOR,
}
_IGNORED = frozenset({"button", "spacer"})
_CONTAINERS = frozenset({"group", "dynamiclist"})
Component = Mapping[str, Any]
_DATE_KINDS = {"date": FieldKind.DATE, "time": FieldKind.TIME}
_EXPRESSIONS = ("label", "description", "readonly", "disabled", "source", "url", "dataSource")


class BadForm(Problem):
    """A form cannot be deployed; `faults` lists all its faults."""

    def __init__(self, faults: Sequence[Message]) -> None:
        self.code = faults[0].code
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        listed = [with_code("message", fault) for fault in faults[:MAX_FIELDS]]
        super().__init__(
            422,
            "Form cannot be deployed",
            faults[0] if not more else f"{faults[0]}{more}",
            "urn:handover:bad-form",
            {"faults": listed},
        )


@dataclass(frozen=True, slots=True)
class FormFile:
    """A form that was read: its id, its title, its JSON, and what it has that is not supported."""

    id: str
    title: str
    schema: Mapping[str, Any]
    warnings: tuple[Message, ...] = ()


def is_form_js(schema: Mapping[str, Any]) -> bool:
    """Return whether this is the JSON of form-js."""
    return isinstance(schema.get("components"), list)


def read_form(content: bytes, name: str | None = None) -> FormFile:
    """Return the form of a file; raise `BadForm` with all its faults. `name` is the id of one without id."""
    if len(content) > MAX_FORM_BYTES:
        raise BadForm([message("form.too_big", "a form has at most {max} bytes", max=MAX_FORM_BYTES)])
    try:
        schema = orjson.loads(content)
    except orjson.JSONDecodeError as error:
        raise BadForm([message("form.not_json", "the form is no JSON: {error}", error=str(error))]) from None
    if not isinstance(schema, dict) or not is_form_js(schema):
        raise BadForm([message("form.not_form_js", "a form of form-js is an object with components")])
    faults: list[Message] = []
    warnings: list[Message] = []
    form_id = schema.get("id") or name
    if not isinstance(form_id, str) or not 0 < len(form_id) <= 200 or "\0" in form_id:
        faults.append(message("form.no_id", "the form needs an id of at most 200 characters"))
        form_id = ""
    for count, (component, depth) in enumerate(_walk(schema["components"], 0), 1):
        if count > MAX_FIELDS or depth > MAX_DEPTH:
            faults.append(
                message(
                    "form.too_many",
                    "a form has at most {count} components, nested at most {depth} deep",
                    count=MAX_FIELDS,
                    depth=MAX_DEPTH,
                )
            )
            break
        _check_component(component, faults, warnings)
    if faults:
        raise BadForm(faults)
    title = schema.get("name") or schema.get("title") or form_id
    return FormFile(form_id, str(title)[:500], schema, tuple(dict.fromkeys(warnings)))


def _walk(components: Any, depth: int) -> Iterator[tuple[Mapping[str, Any], int]]:
    for component in components if isinstance(components, list) else ():
        if isinstance(component, Mapping):
            yield component, depth
            if depth <= MAX_DEPTH:
                yield from _walk(component.get("components"), depth + 1)


def _check_component(component: Mapping[str, Any], faults: list[Message], warnings: list[Message]) -> None:
    type_ = component.get("type")
    where = str(component.get("label") or component.get("key") or component.get("id") or type_)[:100]
    if type_ not in _KINDS and type_ not in _IGNORED:
        warnings.append(
            message(
                "form.unsupported",
                'the component "{where}" of type {type} is not shown',
                where=where,
                type=str(type_)[:100],
            )
        )
        return
    kind = _KINDS.get(str(type_))
    if kind is not None and kind not in WITHOUT_VALUE:
        key = component.get("path" if kind is FieldKind.LIST else "key")
        if not isinstance(key, str) or _PATH.fullmatch(key) is None:
            faults.append(
                message("form.bad_key", 'the component "{where}" needs a key that is a name', where=where)
            )
    for text in _expressions(component):
        try:
            read_feel(text)
        except ExpressionError as error:
            faults.append(
                message("form.bad_expression", 'the component "{where}": {why}', where=where, why=str(error))
            )


def _expressions(component: Mapping[str, Any]) -> Iterator[str]:
    hide = _record(component.get("conditional")).get("hide")
    if isinstance(hide, str) and hide.strip():
        yield hide
    for name in ("valuesExpression", "expression"):
        if isinstance(component.get(name), str) and component[name].strip():
            yield component[name]
    texts = [component.get(name) for name in _EXPRESSIONS]
    texts += list(_record(component.get("validate")).values())
    yield from (text for text in texts if isinstance(text, str) and text.startswith("="))


@dataclass
class Resolved:
    """The fields for the present data, and whether they depend on it."""

    fields: tuple[Field, ...]
    is_dynamic: bool


def resolve(schema: Mapping[str, Any], data: Mapping[str, Any]) -> Resolved:
    """Return the visible fields of a form for `data`, which has the values typed so far."""
    reader = _Reader(data)
    fields = tuple(reader.fields(schema.get("components"), "", 0))
    return Resolved(fields, reader.is_dynamic)


def check(
    schema: Mapping[str, Any], data: Mapping[str, Any], outputs: Mapping[str, Any]
) -> tuple[dict[str, Any], list[FieldFault]]:
    """Return the result as the form defines it, and the faults by field.

    It has the values of visible fields only; read-only ones keep their value, computed ones are computed.
    """
    variables = {**data, **outputs}
    fields = resolve(schema, variables).fields
    before = {field.path: field for field in _with_value(resolve(schema, data).fields)}
    values: dict[str, Any] = {}
    faults: list[FieldFault] = []
    for field in _with_value(fields):
        if field.kind is FieldKind.COMPUTED:
            value = field.initial
        elif field.is_read_only:
            value = before.get(field.path, field).initial
        else:
            value = value_at(outputs, field.path)
            faults += _faults(field, value)
        if value is not None:
            put_at(values, field.path, value)
    return values, faults


def _with_value(fields: Sequence[Field]) -> Iterator[Field]:
    for field in fields:
        if field.kind is FieldKind.GROUP:
            yield from _with_value(field.fields)
        elif field.kind not in WITHOUT_VALUE:
            yield field


def _faults(field: Field, value: Json) -> Iterator[FieldFault]:
    if field.kind is FieldKind.LIST:
        items = [] if value is None else value
        if not isinstance(items, list) or len(items) > MAX_LIST_ITEMS:
            reason = message("form.list", "this is no list of at most {max} items", max=MAX_LIST_ITEMS)
            yield FieldFault(field.path, reason)
            return
        for nth, item in enumerate(items):
            for inner in _with_value(field.fields):
                own_value = value_at(item, inner.path) if isinstance(item, Mapping) else None
                for fault in _faults(inner, own_value):
                    yield FieldFault(f"{field.path}.{nth}.{fault.path}", fault.reason)
        return
    reason_ = value_fault(field, value)
    if reason_ is not None:
        yield FieldFault(field.path, reason_)


class _Reader:
    """Reads components for some data; `is_dynamic` says whether there was an expression."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        self._data = data
        self.is_dynamic = False
        self._readers: Mapping[FieldKind, Callable[[Field, Component, str, int], Field]] = {
            FieldKind.GROUP: self._group,
            FieldKind.LIST: self._list,
            FieldKind.NOTE: self._note,
            FieldKind.IMAGE: self._image,
            FieldKind.LINK: self._link,
            FieldKind.TABLE: self._table,
            FieldKind.SEPARATOR: self._separator,
            FieldKind.COMPUTED: self._computed,
        }

    def fields(self, components: Any, prefix: str, depth: int) -> Iterator[Field]:
        """Yield the fields of visible components."""
        for component in components if isinstance(components, list) and depth <= MAX_DEPTH else ():
            if not isinstance(component, Mapping) or component.get("type") not in _KINDS:
                continue
            hide = _record(component.get("conditional")).get("hide")
            if isinstance(hide, str) and hide.strip() and self._feel(hide) is True:
                continue
            yield self._field(component, prefix, depth)

    def _field(self, component: Mapping[str, Any], prefix: str, depth: int) -> Field:
        type_ = str(component["type"])
        kind = _KINDS[type_]
        if type_ == "datetime":
            kind = _DATE_KINDS.get(str(component.get("subtype")), FieldKind.DATETIME)
        name = component.get("path" if type_ in _CONTAINERS else "key")
        key = name if isinstance(name, str) else ""
        path = f"{prefix}{key}" if kind not in WITHOUT_VALUE else f"#{component.get('id') or ''}"
        field = Field(
            path,
            kind,
            self._label(component, key),
            self._text(component.get("description")) or None,
            is_read_only=self._flag(component.get("readonly")) or self._flag(component.get("disabled")),
        )
        reader = self._readers.get(kind, self._with_rules)
        return reader(field, component, prefix, depth)

    def _group(self, field: Field, component: Component, prefix: str, depth: int) -> Field:
        key = component.get("path")
        inner = f"{prefix}{key}." if isinstance(key, str) and key else prefix
        return replace(field, fields=tuple(self.fields(component.get("components"), inner, depth + 1)))

    def _note(self, field: Field, component: Component, _: str, __: int) -> Field:
        text = self._text(component.get("text") or component.get("content"))
        return replace(field, label=_TAGS.sub(" ", text) if component["type"] == "html" else text)

    def _image(self, field: Field, component: Component, _: str, __: int) -> Field:
        source = self._text(component.get("source"))
        return replace(field, label=self._text(component.get("alt")), initial=source)

    def _link(self, field: Field, component: Component, _: str, __: int) -> Field:
        return replace(field, initial=self._text(component.get("url")))

    def _separator(self, field: Field, _: Component, __: str, ___: int) -> Field:
        return field

    def _computed(self, field: Field, component: Component, _: str, __: int) -> Field:
        expression = component.get("expression")
        return replace(field, initial=self._feel(expression) if isinstance(expression, str) else None)

    def _with_rules(self, field: Field, component: Component, _: str, __: int) -> Field:
        rules = _record(component.get("validate"))
        initial = component.get("defaultValue")
        if has_value(self._data, field.path):
            initial = value_at(self._data, field.path)
        kind_of_text = rules.get("validationType")
        appearance = _record(component.get("appearance"))
        is_choice = field.kind in {FieldKind.CHOICE, FieldKind.CHOICES}
        return replace(
            field,
            initial=initial,
            is_required=self._flag(rules.get("required")),
            options=self._options(component) if is_choice else (),
            minimum=self._number(rules.get("min")),
            maximum=self._number(rules.get("max")),
            min_length=self._count(rules.get("minLength")),
            max_length=self._count(rules.get("maxLength")),
            pattern=str(rules["pattern"])
            if rules.get("pattern") and kind_of_text in {None, "", "custom"}
            else None,
            text_format=kind_of_text if kind_of_text in {"email", "phone"} else None,
            decimals=self._count(component.get("decimalDigits")) if field.kind is FieldKind.NUMBER else None,
            unit=self._text(appearance.get("suffixAdorner") or appearance.get("prefixAdorner")) or None,
            is_text=component.get("serializeToString") is True,
        )

    def _list(self, field: Field, component: Component, _: str, depth: int) -> Field:
        """Return a list; conditions of its components see the data of the whole form."""
        inner = tuple(self.fields(component.get("components"), "", depth + 1))
        initial = value_at(self._data, field.path)
        if not isinstance(initial, list):
            count = self._count(component.get("defaultRepetitions"))
            initial = [{} for _ in range(min(1 if count is None else count, MAX_LIST_ITEMS))]
        return replace(field, fields=inner, initial=initial)

    def _table(self, field: Field, component: Component, _: str, __: int) -> Field:
        source = component.get("dataSource")
        rows = self._feel(source) if isinstance(source, str) else None
        rows = [dict(row) for row in rows if isinstance(row, Mapping)] if isinstance(rows, list) else []
        drawn_columns = component.get("columns")
        if isinstance(component.get("columnsExpression"), str):
            drawn_columns = self._feel(component["columnsExpression"])
        columns = [
            (str(column.get("key")), str(column.get("label") or column.get("key")))
            for column in (drawn_columns if isinstance(drawn_columns, list) else ())
            if isinstance(column, Mapping)
        ]
        if not columns and rows:
            columns = [(name, name) for name in rows[0]]
        return replace(field, columns=tuple(columns), initial=rows[:MAX_LIST_ITEMS])

    def _options(self, component: Mapping[str, Any]) -> tuple[Option, ...]:
        choices = component.get("values")
        if isinstance(component.get("valuesExpression"), str):
            choices = self._feel(component["valuesExpression"])
        elif isinstance(component.get("valuesKey"), str):
            self.is_dynamic = True
            choices = value_at(self._data, component["valuesKey"])
        options = []
        for choice in (choices if isinstance(choices, list) else [])[:MAX_LIST_ITEMS]:
            if isinstance(choice, Mapping):
                value = choice.get("value")
                options.append(Option(value, self._text(choice.get("label")) or str(value)))
            elif choice is not None:
                options.append(Option(choice, str(choice)))
        return tuple(options)

    def _label(self, component: Mapping[str, Any], key: str) -> str:
        for name in ("label", "dateLabel", "timeLabel"):
            text = self._text(component.get(name))
            if text:
                return text
        return key

    def _text(self, text: Json) -> str:
        """Return a text, whose templates `{{…}}` and expressions are evaluated."""
        if not isinstance(text, str):
            return ""
        if text.startswith("="):
            return _shown(self._feel(text))
        return _TEMPLATE.sub(lambda match: _shown(self._feel(match.group(1))), text)

    def _flag(self, flag: Json) -> bool:
        return self._feel(flag) is True if isinstance(flag, str) and flag else flag is True

    def _number(self, number: Json) -> float | None:
        value = self._feel(number) if isinstance(number, str) and number else number
        return value if isinstance(value, int | float) and not isinstance(value, bool) else None

    def _count(self, count: Json) -> int | None:
        number = self._number(count)
        return None if number is None else int(number)

    def _feel(self, text: str) -> Json:
        """Return the value of an expression; null if it cannot be evaluated."""
        self.is_dynamic = True
        try:
            return read_feel(text).value(self._data)
        except ExpressionError:
            return None


def _shown(value: Json) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else orjson.dumps(value).decode()


def _record(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
