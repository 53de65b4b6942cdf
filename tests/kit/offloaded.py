"""Functions that tests run in another process, which imports them by name."""

import os
import time
from pathlib import Path


def process_id() -> int:
    print("what is printed does not disturb the answer")
    return os.getpid()


def fail(reason: str) -> None:
    raise ValueError(reason)


def sleep_and_mark(path: Path) -> None:
    path.write_text(str(os.getpid()))
    time.sleep(600)


def end_at_once() -> None:
    os._exit(3)


class FailsToTravel(Exception):
    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} {second}")


def fail_with_what_cannot_travel() -> None:
    raise FailsToTravel("one", "two")
