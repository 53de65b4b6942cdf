"""What a glove needs from outside: its connection, and a listener for its events."""

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:  # a glove refers to its listener, too
    from handover_gloves.gloves.glove import Glove


class GloveLink(Protocol):
    """The connection of a glove."""

    def end(self, reason: str) -> None:
        """Send the reason to the glove and close."""


class GloveListener(Protocol):
    """Receives the events of gloves."""

    def state_changed(self, glove: "Glove") -> None:
        """Called when the content of the Device entity may have changed."""

    def went_silent(self, glove: "Glove") -> None:
        """Called when the glove stopped sending during a Task."""

    def came_back(self, glove: "Glove") -> None:
        """Called with the first frame, and with the first one after silence."""

    def needs_calibration(self, glove: "Glove", reason: str) -> None:
        """Called when the glove should be calibrated again; `reason` is half a sentence."""

    def calibration_restored(self, glove: "Glove") -> None:
        """Called when the glove has been calibrated, or somebody else wears it."""
