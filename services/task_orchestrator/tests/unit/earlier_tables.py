"""Takes the tables of the orchestrator back to those of an earlier version, as its release had made them."""

from sqlalchemy import Connection

MADE = {
    1: (
        "ALTER TABLE orchestrator_task_acts DROP COLUMN verified",
        "ALTER TABLE orchestrator_mappings DROP COLUMN verified",
    ),
    2: ("ALTER TABLE orchestrator_messages DROP COLUMN process",),
    3: ("DROP TABLE orchestrator_definition_holds",),
    4: ("ALTER TABLE orchestrator_tasks DROP COLUMN unreadable",),
    5: (
        "DROP INDEX orchestrator_processes_number",
        "ALTER TABLE orchestrator_processes DROP COLUMN number",
        "ALTER TABLE orchestrator_processes DROP COLUMN title",
        "DROP TABLE orchestrator_process_numbers",
    ),
    6: ("DROP TABLE orchestrator_deleted_versions",),
}
"""What undoes the migration from each version."""


def take_back(connection: Connection, version: int) -> None:
    """Make the tables those of `version`."""
    for number in range(max(MADE), version - 1, -1):
        for statement in MADE[number]:
            connection.exec_driver_sql(statement)
    connection.exec_driver_sql(f"UPDATE orchestrator_version SET version = {version}")
