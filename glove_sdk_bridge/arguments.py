"""Types of command line arguments; each function returns the value or raises `ArgumentTypeError`."""

import argparse
import math
from collections.abc import Callable

from glove_sdk_bridge.frames import is_glove_name

CONTROLLER = "http://127.0.0.1:54210"


def add_controller(parser: argparse.ArgumentParser) -> None:
    """Add the URL of the controller."""
    parser.add_argument(
        "--controller", default=CONTROLLER, help="URL of the controller (default: %(default)s)"
    )


def glove_name(text: str) -> str:
    """Return `text` if it is a valid name of a glove."""
    if not is_glove_name(text):
        raise argparse.ArgumentTypeError('a glove is named by 1 to 64 letters, digits, ".", "_" or "-"')
    return text


def poses(text: str) -> tuple[str, ...]:
    """Return the poses in the comma-separated `text`."""
    listed = tuple(part.strip() for part in text.split(","))
    if not all(listed):
        raise argparse.ArgumentTypeError(f"{text!r} is no list of poses such as 1,2,8")
    return listed


def _checked(kind: Callable[[str], float], least: float, most: float, rule: str) -> Callable[[str], float]:
    def check(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text!r} is not {rule}")
        return value

    return check


port = _checked(int, 1, 65_535, "a port from 1 to 65535")
count = _checked(int, 1, 10_000_000, "a whole number above 0")
positive = _checked(float, 1e-3, 1e6, "a number from 0.001 to 1000000")
rate = _checked(float, 5, 500, "a rate from 5 to 500 frames a second")
share = _checked(float, 0, 1, "a share from 0 to 1")
