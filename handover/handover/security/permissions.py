"""Permissions, the roles that include them, and grants of a role for resources."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final, Self

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


_VIEWER: Final = frozenset({Permission.READ})
_OPERATOR: Final = _VIEWER | {Permission.PERFORM_TASKS, Permission.ACKNOWLEDGE_ALERTS}

Texts = Mapping[str, tuple[str, str]]
"""By language: the name of a role, and a sentence about what it may do."""
_NO_TEXTS: Final[Texts] = MappingProxyType({})


class Role(StrEnum):
    """What a grant gives; its value is what databases, tokens and the REST interface have.

    A `service` is a process of ours, a `performer` the program of others that performs the Tasks of a Device;
    people have the other roles. A new role is one entry here; then `make reference` writes what the page and
    the documentation have of it.
    """

    permissions: frozenset[Permission]
    texts: Texts

    def __new__(
        cls, value: str, permissions: frozenset[Permission] = frozenset(), texts: Texts = _NO_TEXTS
    ) -> Self:
        """Make a member; type checkers want the defaults for `Role(value)`, which looks one up."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.permissions, member.texts = permissions, texts
        return member

    @property
    def is_of_people(self) -> bool:
        """Return whether people have it, and the page offers it."""
        return self not in {Role.PERFORMER, Role.SERVICE}

    VIEWER = (
        "viewer",
        _VIEWER,
        {
            "en": ("Viewer", "May see processes, tasks, devices, alerts and robots."),
            "de": ("Betrachter", "Darf Prozesse, Aufgaben, Geräte, Alarme und Roboter sehen."),
            "fi": ("Katselija", "Näkee prosessit, tehtävät, laitteet, hälytykset ja robotit."),
        },
    )
    OPERATOR = (
        "operator",
        _OPERATOR,
        {
            "en": ("Operator", "May also perform tasks and acknowledge alerts."),
            "de": ("Bediener", "Darf außerdem Aufgaben ausführen und Alarme quittieren."),
            "fi": ("Käyttäjä", "Saa lisäksi suorittaa tehtäviä ja kuitata hälytyksiä."),
        },
    )
    ENGINEER = (
        "engineer",
        _OPERATOR
        | {
            Permission.RUN_PROCESSES,
            Permission.DEPLOY_PROCESSES,
            Permission.CONFIGURE,
            Permission.MOVE_ROBOTS,
            Permission.WRITE_ENTITIES,
        },
        {
            "en": ("Engineer", "May also deploy and run processes, configure, and move robots."),
            "de": (
                "Ingenieur",
                "Darf außerdem Prozesse bereitstellen und steuern, konfigurieren und Roboter bewegen.",
            ),
            "fi": (
                "Insinööri",
                "Saa lisäksi ottaa käyttöön ja ajaa prosesseja, määrittää asetuksia ja liikuttaa robotteja.",
            ),
        },
    )
    RESEARCHER = (
        "researcher",
        _VIEWER | {Permission.READ_STUDIES, Permission.CONDUCT_STUDIES, Permission.READ_HEALTH_DATA},
        {
            "en": ("Researcher", "May see, conduct and read studies, and read body signals."),
            "de": ("Forscher", "Darf sehen, Studien durchführen und lesen sowie Körpersignale lesen."),
            "fi": ("Tutkija", "Saa katsella, tehdä ja lukea tutkimuksia sekä lukea kehon signaaleja."),
        },
    )
    ADMIN = (
        "admin",
        _VIEWER | {Permission.READ_AUDIT, Permission.MANAGE_PEOPLE, Permission.MANAGE_SETTINGS},
        {
            "en": ("Administrator", "May see, manage people and settings, and read the audit log."),
            "de": (
                "Administrator",
                "Darf sehen, Personen und Einstellungen verwalten und das Audit-Protokoll lesen.",
            ),
            "fi": ("Ylläpitäjä", "Saa katsella, hallita ihmisiä ja asetuksia sekä lukea tarkastuslokia."),
        },
    )
    PERFORMER = (
        "performer",
        _VIEWER | {Permission.WRITE_ENTITIES, Permission.PERFORM_FOR_DEVICES},
        {
            "en": ("Performer", "A program that performs the Tasks of one Device."),
            "de": ("Ausführendes Programm", "Ein Programm, das die Aufgaben eines Geräts ausführt."),
            "fi": ("Suorittava ohjelma", "Ohjelma, joka suorittaa yhden laitteen tehtävät."),
        },
    )
    SERVICE = (
        "service",
        frozenset(Permission) - {Permission.MANAGE_PEOPLE, Permission.READ_AUDIT},
        {
            "en": ("Service", "A process of Handover itself."),
            "de": ("Dienst", "Ein Prozess von Handover selbst."),
            "fi": ("Palvelu", "Handoverin oma prosessi."),
        },
    )


@dataclass(frozen=True, slots=True)
class Grant:
    """A role for the resources that `resource`, a resource pattern, includes."""

    role: Role
    resource: str = ANY_RESOURCE

    def allows(self, permission: Permission, resource: str) -> bool:
        """Return whether the grant includes `permission` for `resource` (an entity id or `*`)."""
        return permission in self.role.permissions and is_match(self.resource, resource)


OWNER_GRANTS: Final = tuple(Grant(role) for role in Role if role.is_of_people)
"""The grants of the owner of an installation: every role of people, for every resource."""


def is_allowed(grants: Iterable[Grant], permission: Permission, resource: str = ANY_RESOURCE) -> bool:
    """Return whether one of `grants` includes `permission` for `resource`."""
    return any(grant.allows(permission, resource) for grant in grants)


def is_allowed_somewhere(grants: Iterable[Grant], permission: Permission) -> bool:
    """Return whether one of `grants` includes `permission` for any resource at all."""
    return any(permission in grant.role.permissions for grant in grants)
