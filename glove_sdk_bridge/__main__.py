"""`python -m glove_sdk_bridge`: forward, replay, serial, simulate, record or calibrate."""

import argparse
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from glove_sdk_bridge.calibration import Calibrator
from glove_sdk_bridge.command_line import parse
from glove_sdk_bridge.controller import Controller
from glove_sdk_bridge.errors import BridgeError
from glove_sdk_bridge.forward import STDIN
from glove_sdk_bridge.frames import HANDS, Hello
from glove_sdk_bridge.link import Link
from glove_sdk_bridge.recorder import Recorder
from glove_sdk_bridge.source import stream
from glove_sdk_bridge.sources import source_kinds

LIFELINE = "HANDOVER_LIFELINE"
"""Set by who starts us as a part of something larger: we end when our standard input does."""


def main(words: list[str] | None = None, program: str = "glove_sdk_bridge") -> int:
    """Do what `words` (those of the command line if None) ask for, and return the exit code.

    0 when it is done or was stopped, 2 when it could not go on, which is said in one line.
    """
    stop = threading.Event()
    try:
        asked = parse(sys.argv[1:] if words is None else words, program)
        with _stopped_by_sigterm(stop):
            if os.environ.get(LIFELINE) and asked.command != "forward":
                threading.Thread(target=_stop_with_parent, args=(stop,), daemon=True).start()
            _do(asked, stop)
    except BridgeError as error:
        _say(f"glove: {error}")
        return 2
    except KeyboardInterrupt:
        return 0
    except SystemExit as end:  # --help
        return end.code if isinstance(end.code, int) else 0
    return 0


def _do(asked: argparse.Namespace, stop: threading.Event) -> None:
    if asked.command == "record":
        Recorder(asked.file, asked.glove, Controller(asked.controller), say=_say).record(stop, asked.seconds)
        return
    if asked.command == "calibrate":
        calibrator = Calibrator(asked.glove, Controller(asked.controller), say=_say)
        if asked.table is None:
            calibrator.from_hand(stop)
        else:
            calibrator.from_table(asked.table, asked.fist, asked.open, asked.seconds)
        return
    source = source_kinds()[asked.command].make(asked, _say)
    hello = Hello(asked.glove, asked.hand or getattr(source, "hand", None) or HANDS[0], asked.token)
    with Link(hello, asked.host, asked.port, say=_say) as link:
        stream(source, link, stop, _say)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


@contextmanager
def _stopped_by_sigterm(stop: threading.Event) -> Iterator[None]:
    """End as calmly on SIGTERM as on anything else, where signals can be caught."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda *_: stop.set())
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before if before is not None else signal.SIG_DFL)


def _stop_with_parent(stop: threading.Event) -> None:
    while os.read(STDIN, 4096):
        pass
    stop.set()


if __name__ == "__main__":
    sys.exit(main())
