"""Leases: who controls a robot. One person at a time; others may wait for it, and an admin can take it over.

A person who controls can hand over to one who waits. When the control ends otherwise, the person who has
waited longest gets it.
"""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Lease:
    """The control of one robot by one session of one person."""

    session: str
    subject: str
    name: str
    since_s: float
    """Unix time."""


@dataclass(eq=False, slots=True)
class Waiting:
    """A session that waits for the control; `changed` is set when it has it, or when the holder changes."""

    session: str
    subject: str
    name: str
    changed: asyncio.Event = field(default_factory=asyncio.Event)


class Leases:
    """The leases of all robots, by the name of the robot."""

    def __init__(self, now: Callable[[], float] = time.time) -> None:
        self._held: dict[str, Lease] = {}
        self._waiting: dict[str, dict[str, Waiting]] = {}
        self._now = now

    def of(self, robot: str) -> Lease | None:
        """Return who controls `robot`; None if nobody does."""
        return self._held.get(robot)

    def waiting(self, robot: str) -> tuple[Waiting, ...]:
        """Return who waits for the control of `robot`, longest first."""
        return tuple(self._waiting.get(robot, {}).values())

    def acquire(self, robot: str, session: str, subject: str, name: str) -> Lease | None:
        """Give the control of `robot` to `session`; return the lease, or None if another session has it."""
        if robot in self._held:
            return None
        lease = self._held[robot] = Lease(session, subject, name, self._now())
        return lease

    def wait(self, robot: str, session: str, subject: str, name: str) -> Waiting:
        """Wait for the control of `robot`; `holds` says when it is there. End it by `release`."""
        waiting = self._waiting.setdefault(robot, {})[session] = Waiting(session, subject, name)
        return waiting

    def holds(self, robot: str, session: str) -> bool:
        """Return whether `session` controls `robot`."""
        lease = self._held.get(robot)
        return lease is not None and lease.session == session

    def release(self, robot: str, session: str) -> None:
        """End the control or the waiting of `session`; the next who waits gets the control."""
        self._waiting.get(robot, {}).pop(session, None)
        if self.holds(robot, session):
            del self._held[robot]
            for next_one in self.waiting(robot):
                self._give(robot, next_one)
                break

    def hand_over(self, robot: str, to_session: str) -> Lease | None:
        """Give the control to a session that waits; return the lease that ended, None if it does not wait."""
        receiver = self._waiting.get(robot, {}).get(to_session)
        ended = self._held.get(robot)
        if receiver is None or ended is None:
            return None
        self._give(robot, receiver)
        return ended

    def take_over(self, robot: str, session: str, subject: str, name: str) -> Lease | None:
        """Give the control to `session`, also if another one has it; return the lease that ended."""
        ended = self._held.pop(robot, None)
        self.acquire(robot, session, subject, name)
        self._notify(robot)
        return ended

    def revoke(self, robot: str) -> Lease | None:
        """Take the control away from whom has it; return the lease that ended. Who waits gets it."""
        ended = self._held.get(robot)
        if ended is not None:
            self.release(robot, ended.session)
        return ended

    def _give(self, robot: str, receiver: Waiting) -> None:
        self._waiting.get(robot, {}).pop(receiver.session, None)
        self._held[robot] = Lease(receiver.session, receiver.subject, receiver.name, self._now())
        receiver.changed.set()
        self._notify(robot)

    def _notify(self, robot: str) -> None:
        for waiting_session in self.waiting(robot):
            waiting_session.changed.set()
