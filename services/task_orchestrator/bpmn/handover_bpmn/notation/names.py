"""Names: what elements of a file are called in variables and definitions, which are ASCII."""

import hashlib
import re
import unicodedata

from handover_bpmn.languages.native_grammar import is_variable_name

MAX_NODE_ID = 200
MAX_IN_URN = 150
MAX_VARIABLE = 90
"""Shorter than a variable may be, so that a number can follow."""

_PROCESS_ID = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]{0,63}", re.ASCII)
_NODE_ID = re.compile(rf"[^\W\d][\w.\-·]{{0,{MAX_NODE_ID - 1}}}")
_FOREIGN_ID = re.compile(rf"[\w{{}}$][\w.\-·{{}}$]{{0,{MAX_NODE_ID - 1}}}")
_DEFINITION = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}", re.ASCII)
_GENERATED_ID = re.compile(
    r"(?:[A-Z][A-Za-z]*_(?:[0-9a-z]{7}|\d+)|_?[0-9A-Fa-f]{8}-[0-9A-Fa-f-]{27}|(?:sid|id|_)-?[0-9A-Fa-f-]{16,})",
    re.ASCII,
)
"""Ids that drawing tools make, such as `Activity_0k2pzw1` and `UserTask_1`; the drawn name says more."""


def is_process_id(text: str) -> bool:
    """Return whether a text can be the id of a process, which is part of URNs."""
    return _PROCESS_ID.fullmatch(text) is not None


def process_name(id_: str) -> str:
    """Return the name of the definition of a process: its id, or one like it that can be part of URNs."""
    if is_process_id(id_) or not id_:
        return id_
    slug = re.sub(r"[^A-Za-z0-9_.-]+", "-", _plain(id_)).strip("-.")[:40] or "process"
    return f"{slug if slug[0].isalpha() or slug[0] == '_' else 'process-' + slug}-{_digest(id_)}"


def is_node_id(text: str) -> bool:
    """Return whether a text can be the id of another element: a name of XML, of `MAX_NODE_ID` characters."""
    return _NODE_ID.fullmatch(text) is not None


def is_foreign_id(text: str) -> bool:
    """Return whether a text can be an id that a drawing tool makes; UUIDs are no names of XML."""
    return _FOREIGN_ID.fullmatch(text) is not None


def variable_of(element: str) -> str:
    """Return the name of the process variable for the element with the id `element`."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", _plain(element))
    name = (f"_{name}" if not name or name[0].isdigit() else name)[:MAX_VARIABLE]
    return name if is_variable_name(name) else f"{name}_"


def definition_of(element: str, drawn: str) -> str:
    """Return the TaskDefinition of an activity that names none: its id, or its name if that says more."""
    if not _DEFINITION.fullmatch(element):
        return _slug(element) or _slug(drawn) or f"task-{_digest(element)}"
    return (_slug(drawn) or element) if _GENERATED_ID.fullmatch(element) else element


def in_urn(element: str) -> str:
    """Return an element, which may be within called processes, as part of a URN of limited length."""
    if len(element) <= MAX_IN_URN and re.fullmatch(r"[A-Za-z0-9_.-]+", element):
        return element
    return f"{_slug(element)[: MAX_IN_URN - 17]}-{_digest(element)}"


def _slug(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "-", _plain(text)).strip("-").lower()[:100]


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _plain(text: str) -> str:
    """Return a text without accents and other characters beyond ASCII."""
    return unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
