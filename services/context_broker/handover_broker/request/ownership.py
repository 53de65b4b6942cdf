"""Ownership: who may change and delete a subscription or a registration.

What a service of the cell has created is changed by that service alone, because its keys and its work depend
on it. Others delete it with the permission `manageSettings`, for a service that is no more; a service that is
there creates it again. What anybody else has created is changed and deleted by everybody with
`writeEntities`, and belongs to the one who changed it last: from then on that one's rights decide what is
sent. Without accounts everybody is the owner of the installation.
"""

from handover.errors import Problem
from handover.security.caller import CallerKind
from handover.security.permissions import Permission
from handover.security.resource_patterns import ANY_RESOURCE
from handover_broker.model.owner import Owner
from handover_broker.request.request_context import RequestContext


def owner_of(request: RequestContext) -> dict[str, str]:
    """Return the caller as the owner in the document to store, and remember its grants."""
    request.tenant.receivers.note(request.caller)
    return Owner.of(request.caller).stored()


async def shows_results(request: RequestContext, owner: Owner | None) -> bool:
    """Return whether the caller may see how often and when something was sent to `owner`, or what a snapshot
    of `owner` found.

    These may depend on data about bodies of persons. Of an owner whose rights cannot be verified they are not
    shown.
    """
    tenant = request.tenant
    is_own = owner is not None and owner.is_same(Owner.of(request.caller))
    if is_own or tenant.store.may_see_private(somewhere=False):
        return True
    await tenant.receivers.prepare((owner,))
    receiver = tenant.receivers.known(owner, tenant.name)
    return receiver is not None and not receiver.may_see_private(somewhere=True)


def has_new_owner(request: RequestContext, owner: Owner | None) -> bool:
    """Return whether a change by the caller ends the ownership of `owner`, whose counts end with it."""
    return owner is not None and not owner.is_same(Owner.of(request.caller))


def may_see_document(request: RequestContext, owner: Owner | None) -> bool:
    """Return whether the caller may know of a document: who performs for Devices only, of its own ones."""
    if request.caller.kind is CallerKind.LOCAL or request.caller.may(Permission.WRITE_ENTITIES, ANY_RESOURCE):
        return True
    if not request.caller.may_somewhere(Permission.PERFORM_FOR_DEVICES):
        return True  # the authorization has decided by the rights for the tenant
    return owner is not None and owner.is_same(Owner.of(request.caller))


def require_changeable(request: RequestContext, document_id: str, owner: Owner | None, what: str) -> None:
    """Raise a problem (403) if the caller may not change a document of `owner`."""
    if _is_free(request, owner):
        return
    raise _refused(owner, what, document_id, "changed by that service alone; create another one")


def require_deletable(request: RequestContext, document_id: str, owner: Owner | None, what: str) -> None:
    """Raise a problem (403) if the caller may not delete a document of `owner`."""
    if _is_free(request, owner) or (
        request.caller.kind is not CallerKind.SERVICE and request.caller.may(Permission.MANAGE_SETTINGS)
    ):
        return
    raise _refused(
        owner, what, document_id, "deleted by that service, or by an admin if the service is no more"
    )


def _is_free(request: RequestContext, owner: Owner | None) -> bool:
    is_local = request.caller.kind is CallerKind.LOCAL
    return is_local or owner is None or not owner.is_service or owner.is_same(Owner.of(request.caller))


def _refused(owner: Owner | None, what: str, document_id: str, rule: str) -> Problem:
    name = "" if owner is None else owner.name
    return Problem(403, "Not allowed", f"{what} {document_id} belongs to the service {name}: it is {rule}")
