"""An interpreter of the part of URScript that programs of this package use.

Statements are assignments, calls, `while` and `if`; values are numbers, truth values, texts and lists. The
functions are those that the caller passes in; no Python code of a script runs. A function that takes time
returns a generator, which yields once per control cycle.
"""

import ast
import operator
import re
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from handover.errors import HandoverError

MAX_STATEMENTS_PER_CYCLE = 2000
MAX_DEPTH = 20
MAX_SCRIPT_CHARACTERS = 200_000

Scope = dict[str, Any]
Cycles = Generator[None]
Functions = Mapping[str, Callable[..., Any]]
_Evaluate = Callable[[Scope], Any]

_OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
}
_ASSIGNMENT = re.compile(r"^(?:(?:local|global)\s+)?([A-Za-z_]\w*)\s*=(?!=)\s*(.+)$")
_DEFINITION = re.compile(r"^def\s+([A-Za-z_]\w*)\s*\(\s*\)\s*:$")
_BLOCK = re.compile(r"^(while|if|elif)\s+(.+):$")


class ScriptError(HandoverError):
    """The script has an error; the message has the line."""


@dataclass
class _Statement:
    """One statement: an assignment, a call, a loop or branches; `line` is its number in the script."""

    line: int
    evaluate: _Evaluate | None = None
    name: str | None = None
    body: "list[_Statement]" = field(default_factory=list)
    branches: "list[tuple[_Evaluate, list[_Statement]]]" = field(default_factory=list)
    otherwise: "list[_Statement]" = field(default_factory=list)

    @property
    def is_loop(self) -> bool:
        return bool(self.body)


class Program:
    """A script with one function without arguments. Raises `ScriptError` when it cannot be parsed."""

    def __init__(self, script: str, functions: Functions) -> None:
        if len(script) > MAX_SCRIPT_CHARACTERS:
            raise ScriptError(f"the script has more than {MAX_SCRIPT_CHARACTERS} characters")
        self._functions = functions
        self._lines = _significant(script)
        self._at = 0
        _, first = self._next()
        definition = _DEFINITION.match(first)
        if definition is None:
            raise ScriptError(f'a script begins with "def name():", not with "{first[:60]}"')
        self.name = definition[1]
        self._body = self._block(1)
        self._expect_end()

    def run(self) -> Cycles:
        """Run the program; the generator yields once per control cycle. Raises `ScriptError`."""
        scope: Scope = {}
        budget = [MAX_STATEMENTS_PER_CYCLE]
        for _ in self._execute(self._body, scope, budget):
            budget[0] = MAX_STATEMENTS_PER_CYCLE
            yield

    def _execute(self, body: list[_Statement], scope: Scope, budget: list[int]) -> Cycles:
        for statement in body:
            yield from self._execute_one(statement, scope, budget)

    def _execute_one(self, statement: _Statement, scope: Scope, budget: list[int]) -> Cycles:
        self._spend(statement, budget)
        if statement.branches:
            for condition, branch in statement.branches:
                if _value(condition, scope, statement.line):
                    yield from self._execute(branch, scope, budget)
                    return
            yield from self._execute(statement.otherwise, scope, budget)
            return
        evaluate = statement.evaluate
        assert evaluate is not None  # noqa: S101 - every other statement has an expression
        if statement.is_loop:
            while _value(evaluate, scope, statement.line):
                self._spend(statement, budget)
                yield from self._execute(statement.body, scope, budget)
            return
        value = _value(evaluate, scope, statement.line)
        if statement.name is not None:
            scope[statement.name] = value
        elif isinstance(value, Generator):
            yield from value

    @staticmethod
    def _spend(statement: _Statement, budget: list[int]) -> None:
        budget[0] -= 1
        if budget[0] < 0:
            raise ScriptError(f"line {statement.line}: infinite loop without a call that takes time")

    # Parsing

    def _next(self) -> tuple[int, str]:
        if self._at >= len(self._lines):
            raise ScriptError('the script ends without "end"')
        self._at += 1
        return self._lines[self._at - 1]

    def _peek(self) -> str:
        return self._lines[self._at][1] if self._at < len(self._lines) else ""

    def _expect_end(self) -> None:
        number, text = self._next()
        if text != "end":
            raise ScriptError(f'line {number}: "{text[:60]}" where "end" is expected')

    def _block(self, depth: int) -> list[_Statement]:
        if depth > MAX_DEPTH:
            raise ScriptError(f"blocks are nested more than {MAX_DEPTH} deep")
        statements: list[_Statement] = []
        while self._peek() not in {"end", "else:", ""} and not self._peek().startswith("elif "):
            statements.append(self._statement(depth))
        if not statements:
            raise ScriptError("a block is empty")
        return statements

    def _statement(self, depth: int) -> _Statement:
        number, text = self._next()
        block = _BLOCK.match(text)
        if block is None:
            assigned = _ASSIGNMENT.match(text)
            name, expression = (assigned[1], assigned[2]) if assigned else (None, text)
            return _Statement(number, self._compiled(expression, number), name)
        condition = self._compiled(block[2], number)
        if block[1] == "while":
            statement = _Statement(number, condition, body=self._block(depth + 1))
            self._expect_end()
            return statement
        statement = _Statement(number, branches=[(condition, self._block(depth + 1))])
        while (following := _BLOCK.match(self._peek())) and following[1] == "elif":
            number, _ = self._next()
            branch = (self._compiled(following[2], number), self._block(depth + 1))
            statement.branches.append(branch)
        if self._peek() == "else:":
            self._next()
            statement.otherwise = self._block(depth + 1)
        self._expect_end()
        return statement

    def _compiled(self, expression: str, line: int) -> _Evaluate:
        try:
            return self._evaluator(ast.parse(expression.strip(), mode="eval").body)
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise ScriptError(f'line {line}: "{expression[:60]}" is not understood: {error}') from None

    def _evaluator(self, node: ast.AST) -> _Evaluate:  # noqa: PLR0911 - one return for each kind of node
        match node:
            case ast.Constant(value=bool() | int() | float() | str() as value):
                return lambda _: value
            case ast.Name(id=name):
                return lambda scope: scope[name]
            case ast.List(elts=elements):
                parts = [self._evaluator(element) for element in elements]
                return lambda scope: [part(scope) for part in parts]
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
                apply, inner = _OPERATORS[type(op)], self._evaluator(operand)
                return lambda scope: apply(inner(scope))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return self._two(_OPERATORS[type(op)], left, right)
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _OPERATORS:
                return self._two(_OPERATORS[type(op)], left, right)
            case ast.BoolOp(op=op, values=values):
                parts = [self._evaluator(value) for value in values]
                join = all if isinstance(op, ast.And) else any
                return lambda scope: join(part(scope) for part in parts)
            case ast.Subscript(value=value, slice=index):
                return self._two(operator.getitem, value, index)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                if name not in self._functions:
                    raise ValueError(f"there is no function {name}")
                function, parts = self._functions[name], [self._evaluator(argument) for argument in arguments]
                return lambda scope: function(*(part(scope) for part in parts))
            case _:
                raise ValueError(f"{type(node).__name__} is not supported")

    def _two(self, apply: Callable[..., Any], left: ast.AST, right: ast.AST) -> _Evaluate:
        first, second = self._evaluator(left), self._evaluator(right)
        return lambda scope: apply(first(scope), second(scope))


def _value(evaluate: _Evaluate, scope: Scope, line: int) -> Any:
    try:
        return evaluate(scope)
    except KeyError as error:
        raise ScriptError(f"line {line}: {error} has no value") from None
    except (TypeError, ValueError, IndexError, ArithmeticError) as error:
        raise ScriptError(f"line {line}: {error}") from None


def _significant(script: str) -> list[tuple[int, str]]:
    return list(_numbered(script))


def _numbered(script: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(script.splitlines(), 1):
        text = line.split("#", 1)[0].strip()
        if text:
            yield number, text
