"""Who a glove talks to: the line on which it sends, and whoever is told what happens to it."""

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:  # a glove knows its listener, too
    from services.gesture_controller.glove import Glove


class Link(Protocol):
    """The connection of a glove."""

    def end(self, reason: str) -> None:
        """Tell the glove why, and close."""


class Listener(Protocol):
    """Who is told what happens to a glove."""

    def state_changed(self, glove: "Glove") -> None:
        """Take notice that what its Device entity says may have changed."""

    def went_silent(self, glove: "Glove") -> None:
        """Take notice that it stopped sending in the middle of a Task."""

    def came_back(self, glove: "Glove") -> None:
        """Take notice that it sends (again)."""

    def fits_badly(self, glove: "Glove", why: str) -> None:
        """Take notice that it should be calibrated again, and why (half a sentence)."""

    def fits_again(self, glove: "Glove") -> None:
        """Take notice that it has been calibrated, or fits somebody else."""
