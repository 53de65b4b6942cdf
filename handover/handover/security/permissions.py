"""Permissions, the roles that include them, and grants of a role for resources."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from handover.security.resource_patterns import ANY_RESOURCE, is_match


class Permission(StrEnum):
    """What a route asks of its caller."""

    READ = "read"
    """See processes, Tasks, resources, devices, Alerts and the robots' state."""
    READ_HEALTH_DATA = "readHealthData"
    """See body signals, human state and recordings of persons."""
    READ_STUDIES = "readStudies"
    """See sessions, answers and analyses of studies."""
    READ_AUDIT = "readAudit"

    PERFORM_TASKS = "performTasks"
    """Claim and answer Tasks for people, pause own Tasks, confirm a hand-over of a robot, comment."""
    ACKNOWLEDGE_ALERTS = "acknowledgeAlerts"
    """Acknowledge and shelve Alerts, raise one by hand."""
    RUN_PROCESSES = "runProcesses"
    """Start, pause, cancel, migrate and repair processes."""
    DEPLOY_PROCESSES = "deployProcesses"
    """Deploy, change and remove definitions of processes and Tasks."""
    CONFIGURE = "configure"
    """Register devices and resources, calibrate, map gestures, change cells and scenes."""
    MOVE_ROBOTS = "moveRobots"
    """Command motion directly: jog, control, release a stop."""
    PERFORM_FOR_DEVICES = "performForDevices"
    """Perform the Tasks of a Device: see its Tasks, write their status and result, and keep subscriptions of
    one's own. Who may write the Device, with `writeEntities`, may have its lease."""
    CONDUCT_STUDIES = "conductStudies"
    """Begin, answer and delete sessions of studies; start and stop recordings."""
    WRITE_ENTITIES = "writeEntities"
    """Create, change and delete entities, subscriptions and context sources of the broker directly."""

    MANAGE_PEOPLE = "managePeople"
    """Create and delete accounts and Persons; grant roles; issue and revoke tokens."""
    MANAGE_SETTINGS = "manageSettings"
    """Tenants, snapshots, backups and other administration of a service."""

    VERIFY_CALLERS = "verifyCallers"
    """Services only: verify and exchange the credentials of callers, and follow the revocations."""


READING: Final = frozenset(
    {Permission.READ, Permission.READ_HEALTH_DATA, Permission.READ_STUDIES, Permission.READ_AUDIT}
)
"""Permissions that neither move nor change anything; they hold without the stream of revocations."""


class Role(StrEnum):
    """What a grant gives.

    A `service` is a process of ours, a `performer` the program of others that performs the Tasks of a Device;
    people have the other roles.
    """

    VIEWER = "viewer"
    OPERATOR = "operator"
    ENGINEER = "engineer"
    RESEARCHER = "researcher"
    ADMIN = "admin"
    PERFORMER = "performer"
    SERVICE = "service"


_VIEWER: Final = frozenset({Permission.READ})
_OPERATOR: Final = _VIEWER | {Permission.PERFORM_TASKS, Permission.ACKNOWLEDGE_ALERTS}
_ENGINEER: Final = _OPERATOR | {
    Permission.RUN_PROCESSES,
    Permission.DEPLOY_PROCESSES,
    Permission.CONFIGURE,
    Permission.MOVE_ROBOTS,
    Permission.WRITE_ENTITIES,
}
_RESEARCHER: Final = _VIEWER | {
    Permission.READ_STUDIES,
    Permission.CONDUCT_STUDIES,
    Permission.READ_HEALTH_DATA,
}
_ADMIN: Final = _VIEWER | {Permission.READ_AUDIT, Permission.MANAGE_PEOPLE, Permission.MANAGE_SETTINGS}

ROLE_PERMISSIONS: Final[dict[Role, frozenset[Permission]]] = {
    Role.VIEWER: _VIEWER,
    Role.OPERATOR: _OPERATOR,
    Role.ENGINEER: _ENGINEER,
    Role.RESEARCHER: _RESEARCHER,
    Role.ADMIN: _ADMIN,
    Role.PERFORMER: _VIEWER | {Permission.WRITE_ENTITIES, Permission.PERFORM_FOR_DEVICES},
    Role.SERVICE: frozenset(Permission) - {Permission.MANAGE_PEOPLE, Permission.READ_AUDIT},
}


@dataclass(frozen=True, slots=True)
class Grant:
    """A role for the resources that `resource`, a resource pattern, includes."""

    role: Role
    resource: str = ANY_RESOURCE

    def allows(self, permission: Permission, resource: str) -> bool:
        """Return whether the grant includes `permission` for `resource` (an entity id or `*`)."""
        return permission in ROLE_PERMISSIONS[self.role] and is_match(self.resource, resource)


OWNER_GRANTS: Final = tuple(Grant(role) for role in Role if role not in {Role.SERVICE, Role.PERFORMER})
"""The grants of the owner of an installation: every role of people, for every resource."""


def is_allowed(grants: Iterable[Grant], permission: Permission, resource: str = ANY_RESOURCE) -> bool:
    """Return whether one of `grants` includes `permission` for `resource`."""
    return any(grant.allows(permission, resource) for grant in grants)


def is_allowed_somewhere(grants: Iterable[Grant], permission: Permission) -> bool:
    """Return whether one of `grants` includes `permission` for any resource at all."""
    return any(permission in ROLE_PERMISSIONS[grant.role] for grant in grants)
