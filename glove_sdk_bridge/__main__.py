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
from glove_sdk_bridge.controller_client import ControllerClient
from glove_sdk_bridge.errors import BridgeError
from glove_sdk_bridge.forward import STDIN
from glove_sdk_bridge.frame_sender import FrameSender
from glove_sdk_bridge.frames import HANDS, Hello
from glove_sdk_bridge.recorder import Recorder
from glove_sdk_bridge.source import stream
from glove_sdk_bridge.sources import source_kinds
from glove_sdk_bridge.tls import client_context

LIFELINE = "HANDOVER_LIFELINE"
"""Set by a parent process; the bridge then stops when its standard input ends."""


def main(words: list[str] | None = None, program: str = "glove_sdk_bridge") -> int:
    """Run the command in `words` (the command line if None) and return the exit code.

    0 after success or a stop, 2 after an error, which is reported in one line.
    """
    stop = threading.Event()
    try:
        args = parse(sys.argv[1:] if words is None else words, program)
        with _stopped_by_sigterm(stop):
            if os.environ.get(LIFELINE) and args.command != "forward":
                threading.Thread(target=_stop_with_parent, args=(stop,), daemon=True).start()
            _run(args, stop)
    except BridgeError as error:
        _say(f"glove: {error}")
        return 2
    except KeyboardInterrupt:
        return 0
    except SystemExit as end:  # --help
        return end.code if isinstance(end.code, int) else 0
    return 0


def _run(args: argparse.Namespace, stop: threading.Event) -> None:
    if args.command == "record":
        Recorder(args.file, args.glove, ControllerClient(args.controller), say=_say).record(
            stop, args.seconds
        )
        return
    if args.command == "calibrate":
        calibrator = Calibrator(args.glove, ControllerClient(args.controller), say=_say)
        if args.table is None:
            calibrator.from_hand(stop)
        else:
            calibrator.from_table(args.table, args.fist, args.open, args.seconds)
        return
    source = source_kinds()[args.command].make(args, _say)
    hello = Hello(args.glove, args.hand or getattr(source, "hand", None) or HANDS[0], args.token)
    tls = client_context() if args.tls else None
    with FrameSender(hello, args.host, args.port, say=_say, tls=tls) as sender:
        stream(source, sender, stop, _say)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


@contextmanager
def _stopped_by_sigterm(stop: threading.Event) -> Iterator[None]:
    """Set `stop` on SIGTERM, if this is the main thread."""
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
