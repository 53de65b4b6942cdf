"""Who may see and change what: the person, or somebody with the permission for this person.

A person needs no grant for the own data. Reading it is recorded all the same, as is each change.
"""

from typing import Annotated

from fastapi import Request
from starlette.requests import HTTPConnection

from handover.security.audit_trail import begin_act, current_request
from handover.security.caller import Caller
from handover.security.guard import guard_of, in_path, require_signed_in
from handover.security.permissions import Permission

of_person = in_path("Person", "person")
SignedIn = Annotated[Caller, require_signed_in()]


async def require_own_or(request: Request, caller: Caller, permission: Permission, person: str) -> None:
    """Raise `Problem` 403 unless `caller` is the person or has `permission` for the person.

    The intent of a change is recorded then, so the handler calls it before it changes anything.
    """
    guard = guard_of(request)
    resource = guard.settings.entity_id("Person", person)
    act = current_request()
    if act is not None:
        act.caller, act.permission, act.resource = caller, permission, resource
    if caller.person != resource:
        guard.require(caller, permission, resource)
    await begin_act()


def may_see(connection: HTTPConnection, caller: Caller, person: str) -> bool:
    """Return whether `caller` is the person or may read the person's health data."""
    resource = guard_of(connection).settings.entity_id("Person", person)
    return caller.person == resource or caller.may(Permission.READ_HEALTH_DATA, resource)
