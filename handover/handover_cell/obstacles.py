"""What a process waits for until a person acts: its incident, or that of a process which holds a robot."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

Find = Callable[[str], Awaitable[Mapping[str, Any]]]
"""Returns a process by its id; empty if it cannot be found now."""


async def obstacle(process: Mapping[str, Any], find: Find, program: str) -> str | None:
    """Return why a process, as `GET /processes/{id}` describes it, waits for a person; None if it does not.

    What a robot or a person will do without help is no obstacle, even if it takes long. `program` is the
    command that the text names.
    """
    for incident in process.get("incidents", ()):
        return _incident(process, incident, program)
    for waiting in process.get("unallocated", ()):
        holder = waiting.get("reasonParameters", {}).get("process")
        held_by = await find(holder) if holder else {}
        for incident in held_by.get("incidents", ()):
            return f"{waiting['reason']}\n{_incident(held_by, incident, program)}"
    return None


def _incident(process: Mapping[str, Any], incident: Mapping[str, Any], program: str) -> str:
    name = process["id"]
    return (
        f'{name} has an incident at "{incident["name"]}": {incident["reason"]}\n'
        f"Decide on the page Processes, or with a command while the services run (`{program} up`):\n"
        f"  try again:  {program} process retry {name} {incident['token']} --by YOU\n"
        f"  give it up: {program} process cancel {name} --by YOU"
    )
