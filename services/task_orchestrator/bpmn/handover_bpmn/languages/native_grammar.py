"""Grammar: the elements of the expression language. An element that is not listed here is refused.

The text is parsed, but never compiled to Python code.
"""

import ast
import re
import warnings
from collections.abc import Iterator, Mapping

from handover_bpmn.languages.base import (
    MAX_CHARACTERS,
    MAX_DEPTH,
    MAX_NODES,
    ExpressionError,
    Json,
    within_limits,
)

CONSTANTS: Mapping[str, Json] = {"true": True, "false": False, "null": None}
ARGUMENTS: Mapping[str, range] = {
    "len": range(1, 2),
    "abs": range(1, 2),
    "round": range(1, 3),
    "min": range(1, 100),
    "max": range(1, 100),
}
"""The functions and their numbers of arguments; `defined(name)` is handled separately."""

_RESERVED = frozenset({*CONSTANTS, *ARGUMENTS, "True", "False", "None", "and", "or", "not", "in", "is", "if"})
_RESERVED |= frozenset({"else", "defined", "lambda", "for", "while", "import", "from", "def", "class", "del"})

_NAME = re.compile(r"[^\W\d][\w-]*")
_RESERVED_EVERYWHERE = frozenset({*CONSTANTS, "and", "or", "not"})
"""Words that no language can read as a variable."""

_OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.FloorDiv, ast.Mod)
_COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq, ast.In, ast.NotIn, ast.Is, ast.IsNot)
_SIGNS = (ast.Not, ast.USub, ast.UAdd)
_PLAIN = (
    *(ast.BoolOp, ast.BinOp, ast.UnaryOp, ast.Compare, ast.IfExp, ast.List, ast.Subscript),
    *(ast.And, ast.Or, ast.Load, *_OPERATORS, *_COMPARISONS, *_SIGNS),
)


def parse(text: str) -> ast.expr:
    """Return the syntax tree of `text`; raise `ExpressionError` if it is no expression."""
    if not text:
        raise ExpressionError("an expression is empty")
    if len(text) > MAX_CHARACTERS:
        raise ExpressionError(f"an expression has at most {MAX_CHARACTERS} characters, not {len(text)}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text, mode="eval").body
    except SyntaxError as error:
        raise ExpressionError(f"`{text}` is not an expression: {error.msg}") from None
    except (ValueError, RecursionError, MemoryError):
        raise ExpressionError("an expression is too deep or has characters that cannot be read") from None
    try:
        _check(tree)
    except ExpressionError as error:
        raise ExpressionError(f"`{text}`: {error}") from None
    return tree


def is_variable_name(name: str) -> bool:
    """Return whether `name` can be the name of a process variable."""
    return name.isidentifier() and name.isascii() and len(name) <= 100 and name not in _RESERVED


def is_name(name: str) -> bool:
    """Return whether `name` can be the name of a variable in files of others, with their own languages.

    It may be a word that our language reserves, such as `from`, have hyphens, and letters of every script.
    """
    return len(name) <= 100 and _NAME.fullmatch(name) is not None and name not in _RESERVED_EVERYWHERE


def _check(tree: ast.expr) -> None:
    for count, (node, depth) in enumerate(_walk(tree)):
        if count >= MAX_NODES or depth > MAX_DEPTH:
            raise ExpressionError(f"an expression has at most {MAX_NODES} parts, nested {MAX_DEPTH} deep")
        _check_node(node)


def _walk(tree: ast.expr) -> Iterator[tuple[ast.AST, int]]:
    stack: list[tuple[ast.AST, int]] = [(tree, 0)]
    while stack:
        node, depth = stack.pop()
        yield node, depth
        parts = node.args if isinstance(node, ast.Call) else ast.iter_child_nodes(node)
        stack.extend((part, depth + 1) for part in parts)


def _check_node(node: ast.AST) -> None:
    match node:
        case ast.Constant():
            within_limits(node.value)
        case ast.Call():
            _check_call(node)
        case ast.Dict():
            if any(key is None for key in node.keys):
                raise ExpressionError("`**` is not part of the language")
        case ast.Attribute(attr=name) | ast.Name(id=name):
            if name.startswith("__"):
                raise ExpressionError(f'the name "{name}" is not allowed')
        case _ if not isinstance(node, _PLAIN):
            raise ExpressionError(f"{in_words(node)} is not part of the language")


def _check_call(node: ast.Call) -> None:
    name = node.func.id if isinstance(node.func, ast.Name) else None
    if node.keywords or (name not in ARGUMENTS and name != "defined"):
        allowed = ", ".join([*ARGUMENTS, "defined"])
        raise ExpressionError(f"only these functions can be called: {allowed}")
    if name == "defined":
        if len(node.args) != 1 or not isinstance(node.args[0], ast.Name):
            raise ExpressionError("defined() has one argument, the name of a variable")
    elif name is not None and len(node.args) not in ARGUMENTS[name]:
        raise ExpressionError(f"{name}() cannot take {len(node.args)} arguments")


def in_words(node: ast.AST) -> str:
    """Return a readable name of the kind of `node`."""
    name = type(node).__name__
    return "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in name).strip()
