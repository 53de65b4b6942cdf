"""Documents of migrations to another version of a definition."""

from collections.abc import Sequence
from typing import Annotated

from typing_extensions import TypedDict

from handover_processes.documents.document import From, document
from handover_processes.documents.reasons import KnownReason
from handover_processes.process.interventions import MigrationReport


class MigrationFinding(KnownReason):
    """What differs at an element; an obstacle prevents the migration.

    `token` is the token there and `task` its open Task; `target` is the element of the new version, if it has
    another id.
    """

    element: str
    name: str
    target: str | None
    token: str | None
    task: str | None
    obstacle: Annotated[bool, From(lambda finding: finding.is_obstacle)]


class MigrationView(TypedDict):
    """The result of a migration or of its check: it is possible if no finding is an obstacle."""

    process: str
    source: int
    target: int
    possible: Annotated[bool, From(lambda report: report.is_possible)]
    migrated: bool
    findings: list[MigrationFinding]


class MigrationOfAllView(TypedDict):
    """The result of the migration of the processes of a version, or of its check.

    A process that ended meanwhile is not among them.
    """

    definition: str
    source: int
    target: int
    migrated: int
    refused: int
    processes: list[MigrationView]


def migration_view(report: MigrationReport, *, dry: bool) -> MigrationView:
    """Return the result of a migration, or of its check."""
    findings = [
        document(MigrationFinding, finding, task=report.tasks.get(finding.token or ""))
        for finding in report.findings
    ]
    return document(MigrationView, report, migrated=report.is_possible and not dry, findings=findings)


def migration_of_all_view(
    definition: str, source: int, target: int, reports: Sequence[MigrationReport], *, dry: bool
) -> MigrationOfAllView:
    """Return the result of the migration of the processes of a version, or of its check."""
    views = [migration_view(report, dry=dry) for report in reports]
    return {
        "definition": definition,
        "source": source,
        "target": target,
        "migrated": sum(view["migrated"] for view in views),
        "refused": sum(not view["possible"] for view in views),
        "processes": views,
    }
