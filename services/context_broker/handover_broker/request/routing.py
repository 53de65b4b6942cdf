"""Operations and the router that finds them: path, name, parameters and handler of each.

The router refuses parameters that an operation does not have, and `operations.md` is checked against the
list.
"""

from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Final

from handover_broker.model.problems import bad_request_data, method_not_allowed, not_found
from handover_broker.request.request_context import PREFIX, Request, RequestContext, Response

Answering = Callable[[RequestContext], Awaitable[Response]]

_NAME: Final = "{"
_ATTRIBUTES: Final = "attrs"


@dataclass(frozen=True, slots=True)
class Operation:
    """One operation. `path` is the part after /ngsi-ld/v1/, with its variable parts in braces.

    `name` is the operation's name in the standard (table 4.20-1 where it is listed), `clause` that of its
    HTTP binding. `makes_tenant` allows it to create a tenant, `of_no_tenant` means that it finds the tenant
    itself. `is_brief` means that it waits only for the disk and for an @context, and needs no task of its
    own.
    """

    method: str
    path: str
    name: str
    clause: str
    answer: Answering
    parameters: frozenset[str] = frozenset()
    makes_tenant: bool = False
    of_no_tenant: bool = False
    is_brief: bool = False

    @property
    def title(self) -> str:
        """Return its name in metrics."""
        return f"{self.method} {self.path}"


def brief(*operations: Operation) -> tuple[Operation, ...]:
    """Return operations as brief ones."""
    return tuple(replace(operation, is_brief=True) for operation in operations)


@dataclass(slots=True)
class _Route:
    """A path, and its operations by method."""

    template: tuple[str, ...]
    methods: dict[str, Operation] = field(default_factory=dict)
    _words: tuple[tuple[int, str], ...] = ()
    _names: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Note the positions of fixed and variable parts; the first part was compared before."""
        places = tuple(enumerate(self.template))
        self._words = tuple((at, part) for at, part in places[1:] if part != _NAME)
        self._names = tuple(at for at, part in places if part == _NAME)

    def allowed(self) -> tuple[str, ...]:
        """Return the allowed methods."""
        head = ("HEAD",) if "GET" in self.methods else ()
        return (*self.methods, *head, "OPTIONS")

    def names(self, parts: list[str]) -> tuple[str, ...] | None:
        """Return the variable parts if the path matches."""
        for at, word in self._words:
            if parts[at] != word:
                return None
        return tuple([parts[at] for at in self._names])


def _with_whole_url(parts: list[str]) -> list[str]:
    """Return the parts of a path with an id that is a URL, and was not percent-encoded, in one part.

    It ends where `attrs` follows. Without such an id, or with several `attrs`, the parts are returned as they
    are.
    """
    at = next((at for at in range(1, len(parts) - 1) if parts[at].endswith(":") and not parts[at + 1]), None)
    if at is None or parts.count(_ATTRIBUTES) > 1:
        return parts
    end = parts.index(_ATTRIBUTES) if _ATTRIBUTES in parts else len(parts)
    return [*parts[:at], "/".join(parts[at:end]), *parts[end:]]


class Router:
    """Finds the operation of a request."""

    def __init__(self, operations: Iterable[Operation]) -> None:
        self._places: dict[tuple[str, int], list[_Route]] = {}
        self.operations: tuple[Operation, ...] = tuple(operations)
        for operation in self.operations:
            template = tuple(_NAME if part.startswith(_NAME) else part for part in operation.path.split("/"))
            places = self._places.setdefault((template[0], len(template)), [])
            place = next((candidate for candidate in places if candidate.template == template), None)
            if place is None:
                place = _Route(template)
                places.append(place)
            place.methods[operation.method] = operation
        self._fixed: dict[bytes, _Route] = {}
        """The routes of paths without variable parts, by the path as most clients send it."""
        for operation in self.operations:
            if _NAME not in operation.path and (match := self._place_of(operation.path.split("/"))):
                self._fixed[f"{PREFIX}{operation.path}".encode()] = match[0]

    def find(self, request: Request) -> tuple[Operation, tuple[str, ...]]:
        """Return the operation and the variable parts of its path; raise a problem (404 or 405) if there is
        none.

        HEAD finds the same as GET.
        """
        place, names = self._place(request)
        method = request.method
        operation = place.methods.get("GET" if method == "HEAD" else method)
        if operation is None:
            path = request.path
            if path == f"{PREFIX}entities/":  # PUT and PATCH, of an entity without an id (5.6.17, 5.6.18)
                raise bad_request_data("the path ends where the id of an entity belongs; add it")
            allowed = place.allowed()
            raise method_not_allowed(f"{path} takes {', '.join(allowed)}, not {method}", allowed)
        return operation, names

    def allowed(self, request: Request) -> tuple[str, ...]:
        """Return the methods of a path; raise a problem (404) if there is no such path."""
        return self._place(request)[0].allowed()

    def _place(self, request: Request) -> tuple[_Route, tuple[str, ...]]:
        fixed = self._fixed.get(request.raw_path)
        if fixed is not None:
            return fixed, ()
        parts = request.path_parts()
        match = self._place_of(parts) or self._place_of(_with_whole_url(parts))
        if match is not None:
            return match
        hint = f"see {PREFIX}entities and {PREFIX}subscriptions"
        if "" in parts[1:]:
            hint = "percent-encode an id or a name that is a URL, such as http:%2F%2Fa.example%2F1"
        raise not_found(f"there is nothing at {request.path}; {hint}")

    def _place_of(self, parts: list[str]) -> tuple[_Route, tuple[str, ...]] | None:
        for place in self._places.get((parts[0], len(parts)), ()):
            names = place.names(parts)
            if names is not None:
                return place, names
        return None
