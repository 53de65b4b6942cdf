"""The connection of one glove: its hello, its last frame, and counts of what it sent."""

from collections import Counter
from typing import Protocol

from handover_gloves import metrics
from handover_gloves.recognition.frames import Hello

TAKEOVER_SILENCE_S = 3.0
"""A connection that is silent for this time is replaced by a new one of the same glove."""


class GloveLink(Protocol):
    """The connection of a glove."""

    def end(self, reason: str) -> None:
        """Send the reason to the glove and close."""


class ConnectionRefused(ValueError):
    """A glove may not connect now; the message says what to do, `kind` labels it in metrics.

    `retry` says whether the same glove may be admitted later.
    """

    def __init__(self, kind: str, reason: str, *, retry: bool = False) -> None:
        super().__init__(reason)
        self.kind = kind
        self.retry = retry


class Traffic:
    """Counts of the lines of a glove, and its frame rate."""

    def __init__(self) -> None:
        self.frames = 0
        self.dropped: Counter[str] = Counter()
        """Invalid lines by reason."""
        self.rate_hz = 0.0
        self._measured_s, self._measured_frames = 0.0, 0

    def drop(self, reason: str) -> None:
        """Count an invalid line."""
        self.dropped[reason] += 1
        metrics.LINES_DROPPED.labels(reason).inc()

    def measure_rate(self, now_s: float) -> None:
        """Update the frame rate once a second."""
        elapsed_s, before = now_s - self._measured_s, self._measured_frames
        if elapsed_s >= 1.0:
            is_first = not (before or self._measured_s)
            self.rate_hz = 0.0 if is_first else round((self.frames - before) / elapsed_s, 1)
            self._measured_s, self._measured_frames = now_s, self.frames


class ConnectionState:
    """The connection of one glove; all moments are on the event loop's clock."""

    def __init__(self, hello: Hello) -> None:
        self.hello = hello
        """The last hello; before the first one, what the glove is expected to say."""
        self.link: GloveLink | None = None
        self.last_s = float("-inf")
        """When the glove connected or sent a frame last."""
        self.battery: float | None = None
        self.traffic = Traffic()
        self.is_sending = False
        """False once the glove has been silent for too long."""
        self.has_sent = False
        """True from the first frame on."""
        self.is_lost = False
        """True from silence during a Task until the next frame."""
        self.was_present = False
        """True once the glove was connected during the current prompt: only then can it get lost."""

    @property
    def is_connected(self) -> bool:
        """True if the glove has a connection and sent something lately."""
        return self.link is not None and self.is_sending

    def connect(self, link: GloveLink, hello: Hello, now_s: float) -> None:
        """Use `link` from now on; raise `ConnectionRefused` while another connection is in use.

        A connection that has been silent for `TAKEOVER_SILENCE_S` is ended: the network may have lost it.
        """
        name = self.hello.glove
        if self.link is not None and self.link is not link:
            if now_s - self.last_s < TAKEOVER_SILENCE_S:
                raise ConnectionRefused(
                    "in use",
                    f"another connection of {name} is in use; end it, or connect again when it has been "
                    f"silent for {TAKEOVER_SILENCE_S:g} s, or give this glove another name",
                    retry=True,
                )
            self.link.end(f"{name} has connected again, since this connection was silent")
        self.link, self.hello = link, hello
        self.last_s = now_s
        self.is_sending = True

    def disconnect(self, link: GloveLink) -> bool:
        """Forget `link`, which has ended; return False if another connection has replaced it."""
        if self.link is not link:
            return False
        self.link = None
        return True

    def count_frame(self, now_s: float) -> bool:
        """Count a frame; return True if the glove was silent, lost or new before it."""
        self.traffic.frames += 1
        self.last_s = now_s
        return not self.is_sending or self.is_lost or not self.has_sent
