"""The contact limit: a motion stops when the force at the wrist changes by more than a limit.

The force is compared with that at the start of the motion, since the tool and the part have a weight. A stop
lasts until a person resets it. It is advisory: a control cycle late, and without contacts of the links before
the wrist.
"""

from collections.abc import Callable

from handover.control.speed_limits import Allowed
from handover.messages import message

RULE = "contactForce"


class ContactForce:
    """The contact limit of one robot; `force_n` returns the measured force, None without a measurement.

    `allowed` may be called by several threads.
    """

    def __init__(self, max_n: float | None, force_n: Callable[[], float | None]) -> None:
        self.max_n = max_n
        self.force_n = force_n
        self._at_start_n: float | None = None
        self._contact_n: float | None = None

    def begin_motion(self) -> None:
        """Compare with the present force from now on."""
        self._at_start_n = self.force_n()

    def end_motion(self) -> None:
        """Compare no longer: the force changes when the gripper closes."""
        self._at_start_n = None

    def reset(self) -> None:
        """Release the stop after a contact."""
        self._contact_n = None
        if self._at_start_n is not None:
            self._at_start_n = self.force_n()

    def allowed(self) -> tuple[Allowed, ...]:
        """Return the rule; nothing without a limit."""
        if self.max_n is None:
            return ()
        force_n = self.force_n()
        if force_n is None:
            unknown = message("limit.no_force", "the force at the wrist is not measured")
            return (Allowed(RULE, 0.0, reason=unknown),)
        if self._at_start_n is not None and abs(force_n - self._at_start_n) > self.max_n:
            self._contact_n = max(abs(force_n - self._at_start_n), self._contact_n or 0.0)
        if self._contact_n is None:
            return (Allowed(RULE),)
        reason = message(
            "limit.contact",
            "contact with {force_n} N; a person must reset it",
            force_n=f"{self._contact_n:.0f}",
        )
        return (Allowed(RULE, 0.0, reason=reason, needs_reset=True),)
