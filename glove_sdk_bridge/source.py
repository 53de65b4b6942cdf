"""The interface of sources, which produce the frames of a real or simulated glove."""

import threading
from collections.abc import Iterator
from typing import Protocol

from glove_sdk_bridge.errors import BridgeError, Dropped, Say
from glove_sdk_bridge.frame_sender import FrameSender
from glove_sdk_bridge.frames import Frame

FINISH_TIMEOUT_S = 2.0
_CHECK_INTERVAL_S = 0.2


class Source(Protocol):
    """Produces frames. A source that knows the hand has an attribute `hand`, "left" or "right"."""

    @property
    def patience_s(self) -> float | None:
        """How long it waits for the controller before its first frame; None: without limit."""

    @property
    def dropped(self) -> Dropped | None:
        """Counts invalid lines, if it reads lines."""

    def frames(self) -> Iterator[Frame]:
        """Yield frames; the iterator may block, and raises `BridgeError` after a permanent error."""


def stream(source: Source, sender: FrameSender, stop: threading.Event, say: Say) -> None:
    """Send the frames of `source` with `sender` until there are no more, or `stop` is set.

    Raises `BridgeError` if the source or the sender fails, or if no frame could be sent. The source runs in a
    separate thread, which may stay blocked in a read, so that Ctrl-C works at once.
    """
    failures: list[Exception] = []
    finished = threading.Event()

    def pump() -> None:
        try:
            _await_controller(source, sender, stop)
            for frame in source.frames():
                if stop.is_set():
                    break
                sender.send(frame)
        except Exception as error:  # noqa: BLE001 - raised again below, in the thread that can answer it
            failures.append(error)
        finally:
            finished.set()

    threading.Thread(target=pump, name="glove source", daemon=True).start()
    while not (stop.is_set() or sender.failure or finished.wait(_CHECK_INTERVAL_S)):
        pass
    if finished.is_set() and not sender.failure:
        sender.finish(FINISH_TIMEOUT_S)
    if sender.failure:
        raise sender.failure
    if failures:
        raise failures[0]
    if finished.is_set() and sender.dropped and not sender.sent:
        raise BridgeError(
            f"none of the {sender.dropped} frames could be sent; start the controller, then send them again"
        )
    unread = f"; {len(source.dropped)} lines were no frames" if source.dropped else ""
    say(f"{sender.sent} frames sent, {sender.dropped} dropped{unread}")


def _await_controller(source: Source, sender: FrameSender, stop: threading.Event) -> None:
    waited_s = 0.0
    while not stop.is_set() and (source.patience_s is None or waited_s < source.patience_s):
        if sender.wait_until_connected(_CHECK_INTERVAL_S):
            return
        waited_s += _CHECK_INTERVAL_S
