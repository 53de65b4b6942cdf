"""Tracked: records by id, with a note of those that a step may have changed.

A step of a process costs what it touches, not what is alive: the snapshot and the index of the state read the
touched records only. Every access that hands a record out counts as a change, since its caller may change it.
`peek` and `peek_all` are for callers that only read.
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, TypeVar, overload

if TYPE_CHECKING:
    from _collections_abc import dict_items, dict_values

R = TypeVar("R")
D = TypeVar("D")


class Tracked(dict[int, R]):
    """A dictionary whose ids grow; dictionaries of the same records share `touched`."""

    __slots__ = ("touched",)

    def __init__(self, touched: set[int] | None = None) -> None:
        super().__init__()
        self.touched: set[int] = set() if touched is None else touched

    def __getitem__(self, key: int) -> R:
        self.touched.add(key)
        return super().__getitem__(key)

    def __setitem__(self, key: int, record: R) -> None:
        self.touched.add(key)
        super().__setitem__(key, record)

    def __delitem__(self, key: int) -> None:
        self.touched.add(key)
        super().__delitem__(key)

    @overload
    def get(self, key: int, default: None = None, /) -> R | None: ...
    @overload
    def get(self, key: int, default: R, /) -> R: ...
    @overload
    def get(self, key: int, default: D, /) -> R | D: ...
    def get(self, key: int, default: Any = None, /) -> Any:
        """Return a record, which then counts as changed."""
        self.touched.add(key)
        return super().get(key, default)

    def values(self) -> "dict_values[int, R]":
        """Return all records, which then count as changed."""
        self.touched.update(self)
        return super().values()

    def items(self) -> "dict_items[int, R]":
        """Return all records by id; they then count as changed."""
        self.touched.update(self)
        return super().items()

    def peek(self, key: int) -> R | None:
        """Return a record that the caller does not change."""
        return super().get(key)

    def peek_all(self) -> Iterable[R]:
        """Return all records; the caller does not change them."""
        return super().values()
