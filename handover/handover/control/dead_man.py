"""The dead-man function: the robot moves only while the control is held and its messages arrive.

After a lost message, a release, or a session that begins, the control has to be released before it acts: a
button that is stuck never starts a motion. Times are those of a monotonic clock in s; any thread may ask.
"""

from typing import Final

TIMEOUT_S: Final = 0.1
"""Age of the last message at which the stop begins; clients send at 20 Hz or more."""


class DeadMan:
    """The state of one control."""

    def __init__(self, timeout_s: float = TIMEOUT_S) -> None:
        self._timeout_s = timeout_s
        self._is_held = False
        self._is_armed = False
        self._received_s = float("-inf")

    def receive(self, now_s: float, *, is_held: bool) -> None:
        """Note a message of the control."""
        if now_s - self._received_s > self._timeout_s:
            self._is_armed = False  # messages were lost
        if not is_held:
            self._is_armed = True
        self._is_held = is_held
        self._received_s = now_s

    def disarm(self) -> None:
        """Require a release before the next motion."""
        self._is_armed = False

    def permits(self, now_s: float) -> bool:
        """Return whether the robot may move."""
        return self._is_held and self._is_armed and now_s - self._received_s <= self._timeout_s

    def needs_release(self, now_s: float) -> bool:
        """Return whether the control is held without effect."""
        return self._is_held and not self.permits(now_s)
