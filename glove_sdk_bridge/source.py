"""A source: anything that frames come from. Every glove, real or not, is one of these."""

import threading
from collections.abc import Iterator
from typing import Protocol

from glove_sdk_bridge.errors import BridgeError, Dropped, Say
from glove_sdk_bridge.frames import Frame
from glove_sdk_bridge.link import Link

FINISH_WITHIN_S = 2.0
_LOOK_EVERY_S = 0.2


class Source(Protocol):
    """Where frames come from. One that knows the hand has an attribute `hand`, "left" or "right"."""

    @property
    def patience_s(self) -> float | None:
        """How long it can wait for the controller before its first frame; None for as long as it takes."""

    @property
    def dropped(self) -> Dropped | None:
        """Counts what it could not read, if it reads anything."""

    def frames(self) -> Iterator[Frame]:
        """Yield frames as they are made; the iterator may block, and raises `BridgeError` at a dead end."""


def stream(source: Source, link: Link, stop: threading.Event, say: Say) -> None:
    """Send the frames of `source` over `link` until there are no more, or `stop` is set.

    Raises `BridgeError` when the source or the link cannot go on, or not a single frame could be sent. The
    source runs in a thread of its own, which may be left blocked in a read: it must not keep a person's
    Ctrl-C waiting.
    """
    failures: list[Exception] = []
    finished = threading.Event()

    def pump() -> None:
        try:
            _await_controller(source, link, stop)
            for frame in source.frames():
                if stop.is_set():
                    break
                link.send(frame)
        except Exception as error:  # noqa: BLE001 - raised again below, in the thread that can answer it
            failures.append(error)
        finally:
            finished.set()

    threading.Thread(target=pump, name="glove source", daemon=True).start()
    while not (stop.is_set() or link.failure or finished.wait(_LOOK_EVERY_S)):
        pass
    if finished.is_set() and not link.failure:
        link.finish(FINISH_WITHIN_S)
    if link.failure:
        raise link.failure
    if failures:
        raise failures[0]
    if finished.is_set() and link.dropped and not link.sent:
        raise BridgeError(
            f"none of the {link.dropped} frames could be sent; start the controller, then send them again"
        )
    unread = f"; {len(source.dropped)} lines were no frames" if source.dropped else ""
    say(f"{link.sent} frames sent, {link.dropped} dropped{unread}")


def _await_controller(source: Source, link: Link, stop: threading.Event) -> None:
    waited_s = 0.0
    while not stop.is_set() and (source.patience_s is None or waited_s < source.patience_s):
        if link.wait_until_connected(_LOOK_EVERY_S):
            return
        waited_s += _LOOK_EVERY_S
