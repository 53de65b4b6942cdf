"""Losses: what a rule should have passed on and did not, as metrics by cause and as Alerts.

A loss is a message or version that the mapping asks to keep. What a rule lets go on purpose is none: values
that give way to newer ones with `buffer: latest`, thinning by `every_ms`, dead bands.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from ros_fiware_bridge.running.tally import Tally

REPORT_EVERY_S = 10.0
"""An Alert of a loss that goes on is written at most so often."""
CAUSES: Mapping[str, str] = {
    "reader_overflow": "came faster than the bridge read them; raise `buffer: {keep: …}` or `qos: "
    "{depth: …}`, or thin them out with `every_ms`",
    "unreadable": "could not be read or were too large ({why}); name the robot's definition in type_paths, "
    "or raise HANDOVER_ROS_MOST_BYTES",
    "broker_away": "gave way to newer ones while the broker was away; raise `buffer: {keep: …}`",
    "broker_slow": "gave way to newer ones because the broker takes them too slowly; raise "
    "`buffer: {keep: …}`, thin them out with `every_ms`, or give the broker more room",
    "refused": "were refused by the broker ({why}); change the rule or the entity",
    "queue_full": "waited for a call that takes too long and gave way to newer ones; look at the service",
}


@dataclass(slots=True)
class _Reported:
    number: int
    at_s: float


class Losses:
    """Has an Alert announced for each rule and cause with losses: `announce(rule, key, description)`."""

    def __init__(self, tallies: Iterable[Tally], announce: Callable[[str, str, str], None]) -> None:
        self._tallies = tuple(tallies)
        self._announce = announce
        self._reported: dict[tuple[str, str], _Reported] = {}

    def look(self, now_s: float) -> None:
        """Announce what was lost since the last look."""
        for tally in self._tallies:
            for cause, number in tally.losses.items():
                key = tally.name, cause
                known = self._reported.get(key)
                if known is not None and (number == known.number or now_s - known.at_s < REPORT_EVERY_S):
                    continue
                self._reported[key] = _Reported(number, now_s)
                words = CAUSES[cause].replace("{why}", tally.last_fault or "see the log")
                self._announce(tally.name, f"lost {cause}", f"{tally.name}: {number} messages {words}")
