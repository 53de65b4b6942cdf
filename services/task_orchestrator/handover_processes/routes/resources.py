"""Resources of routes: the entities for which a caller needs a permission.

A process has the resource of its definition, so a grant for a ProcessDefinition includes its processes. A
Task has several, of which one suffices: the entities that it involves, and its definition. What does not
exist has the resource `*`: only a caller with a grant for everything learns that it does not exist.
"""

from starlette.requests import HTTPConnection

from handover.errors import Problem
from handover.security.audit_trail import current_request
from handover.security.guard import ResourceOf
from handover.security.resource_patterns import ANY_RESOURCE
from handover_processes.definitions.definition_registry import DefinitionRegistry
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.tasks import TaskRecord
from handover_processes.running.components import Components


def acting_name(name: str) -> str:
    """Return the name under which the caller of the current request acts; `given` counts without accounts."""
    act = current_request()
    caller = None if act is None else act.caller
    return name.strip() if caller is None else caller.acting_name(name)


def of_definition(registry: DefinitionRegistry) -> ResourceOf:
    """Return the resource of routes with the path parameter `name`."""

    def resource(connection: HTTPConnection) -> str:
        version = connection.query_params.get("version", "")
        return definition_id(
            registry,
            str(connection.path_params["name"]),
            int(version) if version.isascii() and version.isdecimal() else None,
        )

    resource.__doc__ = "the ProcessDefinition `{name}`"
    return resource


def of_definition_query(registry: DefinitionRegistry) -> ResourceOf:
    """Return the resource of routes with the query parameter `definition`; `*` without it."""

    def resource(connection: HTTPConnection) -> str:
        name = connection.query_params.get("definition")
        return ANY_RESOURCE if name is None else definition_id(registry, name)

    resource.__doc__ = "the ProcessDefinition `?definition`, or every resource without one"
    return resource


def of_process(at: Components) -> ResourceOf:
    """Return the resource of routes with the path parameter `process_id`."""

    async def resource(connection: HTTPConnection) -> str:
        return await process_resource(at, str(connection.path_params["process_id"]))

    resource.__doc__ = "the ProcessDefinition of the process"
    return resource


def of_task(at: Components) -> ResourceOf:
    """Return the resources of routes with the path parameter `task_id`."""
    state = at.orchestrator.state

    async def resources(connection: HTTPConnection) -> tuple[str, ...]:
        task_id = at.settings.entity_id("Task", str(connection.path_params["task_id"]))
        owner = state.active_processes.owner(task_id)
        task: TaskRecord | None = owner.tasks.get(task_id) if owner is not None else None
        if task is None:
            task = await state.on_disk(state.store.task, task_id)
        if task is None:
            return (ANY_RESOURCE,)
        involved = (str(link["object"]) for link in task.entity["involves"]["value"])
        return (*involved, await process_resource(at, task.process))

    resources.__doc__ = "a resource that the Task involves, or its ProcessDefinition"
    return resources


def definition_id(registry: DefinitionRegistry, name: str, version: int | None = None) -> str:
    """Return the id of the ProcessDefinition of a version, by default the latest; `*` if there is none."""
    try:
        return registry.entity_id_of(registry.record(name, version))
    except Problem:
        return ANY_RESOURCE


async def process_resource(at: Components, process_id: str) -> str:
    """Return the resource of a process; `*` if it does not exist."""
    state, plain_id = at.orchestrator.state, at.plain_id(process_id)
    active = state.active_processes.processes.get(plain_id)
    record: ProcessRecord | None = active.record if active is not None else None
    if record is None:
        records: list[ProcessRecord] = await state.on_disk(state.store.processes, [plain_id])
        record = records[0] if records else None
    if record is None:
        return ANY_RESOURCE
    return definition_id(state.registry, record.definition, record.version)
