"""Work in control cycles."""

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")

Cycles = Generator[float, None, T]
"""It yields the time on the clock of the robot at which it continues."""
