"""Routes: the tasklist: people claim, return, decline and complete Tasks, and comment on them."""

from typing import Annotated, Any

from fastapi import FastAPI, Path, Query, Request, Response
from starlette.responses import JSONResponse

from handover.database.outage import shown_after_change
from handover.errors import Problem
from handover.http.api_description import TaggedRoutes
from handover.http.body_limit import max_body
from handover.security.caller import Caller
from handover.security.guard import require
from handover.security.permissions import Permission
from handover.security.proofs.pin_check import require_pin
from handover.tasks.task_life import is_for_people
from handover_datamodels.entities import TaskStatus
from handover_processes.documents.document import document, documents, json_response
from handover_processes.documents.forms import TaskForm
from handover_processes.documents.processes import process_name
from handover_processes.documents.requests import (
    MAX_PARAMETERS_BYTES,
    ClaimRequest,
    CommentRequest,
    CompleteRequest,
    DeclineRequest,
    FormData,
    ReturnRequest,
    TaskListQuery,
)
from handover_processes.documents.tasklist import (
    TaskComment,
    TaskDetails,
    TaskHistoryEntry,
    TasklistEntry,
    is_listed,
    list_order,
    resolved_form,
    task_details,
    task_history,
    tasklist_entry,
)
from handover_processes.people_acts import requires_pin
from handover_processes.records.tasks import TaskRecord
from handover_processes.routes.resources import of_process, of_task
from handover_processes.running.components import Components

DETAILS: dict[int | str, dict[str, Any]] = {200: {"model": TaskDetails}}
COMMENTED: dict[int | str, dict[str, Any]] = {201: {"model": TaskComment}}
TaskId = Annotated[str, Path(max_length=300)]


def add_tasklist(app: FastAPI, at: Components) -> None:
    """Add the routes of Tasks for people."""
    routes = TaggedRoutes(app, "tasklist")
    tasklist, state = at.orchestrator.tasklist, at.orchestrator.state

    @routes.get(
        "/tasks", responses={200: {"model": list[TasklistEntry]}}, dependencies=[require(Permission.READ)]
    )
    async def tasks(query: Annotated[TaskListQuery, Query()], request: Request) -> Response:
        """Return the open Tasks of people, those that are due first before others.

        `before` with the id of the last one returns the next page: the header `Link` has its address.
        """
        mark = None if query.before is None else await tasklist.task(_urn(at, query.before))
        last = None if mark is None else tasklist_entry(mark, "")
        process = None if query.process is None else at.plain_id(query.process)
        open_tasks = [
            entry
            for running in state.active_processes.processes.values()
            if (process is None or running.record.id == process)
            and (query.definition is None or running.record.definition == query.definition)
            for task in running.tasks.values()
            if is_for_people(link["object"] for link in task.entity["involves"]["value"])
            and is_listed(
                entry := tasklist_entry(task, process_name(state.registry, running.record)),
                query,
                running.record.key,
            )
            and (last is None or list_order(entry) > list_order(last))
        ]
        open_tasks.sort(key=list_order)
        response = json_response(open_tasks[: query.limit])
        if len(open_tasks) > query.limit:
            following = request.url.include_query_params(before=open_tasks[query.limit - 1]["id"])
            response.headers["Link"] = f'<{following.path}?{following.query}>; rel="next"'
        return response

    @routes.get("/tasks/{task_id}", responses=DETAILS, dependencies=[require(Permission.READ, of_task(at))])
    async def task(task_id: TaskId) -> Response:
        """Return a Task of people with its form, comments and history."""
        return json_response(await _details(at, _urn(at, task_id)))

    @routes.get(
        "/tasks/{task_id}/history",
        responses={200: {"model": list[TaskHistoryEntry]}},
        dependencies=[require(Permission.READ, of_task(at))],
    )
    async def history(task_id: TaskId) -> Response:
        """Return what became of a Task, the earliest first."""
        return json_response((await _details(at, _urn(at, task_id)))["history"])

    @routes.post(
        "/tasks/{task_id}/form",
        responses={200: {"model": TaskForm | None}},
        dependencies=[require(Permission.READ, of_task(at))],
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def form(task_id: TaskId, body: FormData) -> Response:
        """Return the form of a Task for the values typed so far: conditions and expressions are evaluated."""
        task_view = await tasklist.task(_urn(at, task_id))
        return JSONResponse(_form(at, task_view, body.values))

    @routes.post("/tasks/{task_id}/claim", responses=DETAILS)
    async def claim(
        task_id: TaskId,
        body: ClaimRequest,
        caller: Annotated[Caller, require(Permission.PERFORM_TASKS, of_task(at))],
    ) -> Response:
        """Claim a Task and start it: 409 if another person or a component has it."""
        groups = [group.strip() for group in body.groups]
        await tasklist.claim(_urn(at, task_id), caller.acting_name(body.by), groups, override=body.override)
        return json_response(await shown_after_change(_details(at, _urn(at, task_id))))

    @routes.post("/tasks/{task_id}/return", responses=DETAILS)
    async def give_back(
        task_id: TaskId,
        body: ReturnRequest,
        caller: Annotated[Caller, require(Permission.PERFORM_TASKS, of_task(at))],
    ) -> Response:
        """Return a claimed Task, so that others can claim it."""
        await tasklist.give_back(_urn(at, task_id), caller.acting_name(body.by), body.why)
        return json_response(await shown_after_change(_details(at, _urn(at, task_id))))

    @routes.post("/tasks/{task_id}/decline", responses=DETAILS)
    async def decline(
        task_id: TaskId,
        body: DeclineRequest,
        caller: Annotated[Caller, require(Permission.PERFORM_TASKS, of_task(at))],
    ) -> Response:
        """Decline a Task with a reason: the next suitable person gets it, or it stays open for others."""
        await tasklist.decline(_urn(at, task_id), caller.acting_name(body.by), body.why.strip())
        return json_response(await shown_after_change(_details(at, _urn(at, task_id))))

    @routes.post("/tasks/{task_id}/complete", responses=DETAILS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def complete(
        task_id: TaskId,
        body: CompleteRequest,
        caller: Annotated[Caller, require(Permission.PERFORM_TASKS, of_task(at))],
    ) -> Response:
        """End a claimed Task: 422 with `faults` by field if its form refuses the result.

        A Task with `requirePin` needs the `pin` of the person who is signed in or has joined the station.
        """
        record = await tasklist.task(_urn(at, task_id))
        if requires_pin(record):
            await require_pin(at.guard, caller, body.pin, record.id)
        await tasklist.complete(
            _urn(at, task_id),
            caller.acting_name(body.by),
            body.outcome,
            body.note.strip(),
            body.outputs,
            performed_by=caller.person,
        )
        return json_response(await shown_after_change(_details(at, _urn(at, task_id))))

    @routes.post("/tasks/{task_id}/comments", status_code=201, responses=COMMENTED)
    async def comment(
        task_id: TaskId,
        body: CommentRequest,
        caller: Annotated[Caller, require(Permission.PERFORM_TASKS, of_task(at))],
    ) -> JSONResponse:
        """Add a comment to a Task."""
        record = await tasklist.task(_urn(at, task_id))
        act = await tasklist.comment(
            record.process, caller.acting_name(body.by), body.text.strip(), task_id=record.id, key=body.id
        )
        return JSONResponse(document(TaskComment, act), 201)

    @routes.post("/processes/{process_id}/comments", status_code=201, responses=COMMENTED)
    async def comment_on_process(
        process_id: str,
        body: CommentRequest,
        caller: Annotated[Caller, require(Permission.PERFORM_TASKS, of_process(at))],
    ) -> JSONResponse:
        """Add a comment to a process."""
        act = await tasklist.comment(
            at.plain_id(process_id), caller.acting_name(body.by), body.text.strip(), key=body.id
        )
        return JSONResponse(document(TaskComment, act), 201)

    @routes.get(
        "/processes/{process_id}/comments",
        responses={200: {"model": list[TaskComment]}},
        dependencies=[require(Permission.READ, of_process(at))],
    )
    async def comments(process_id: str) -> Response:
        """Return the comments on a process and on its Tasks, the earliest first."""
        await state.require_process(at.plain_id(process_id))
        acts = await at.orchestrator.on_disk(at.orchestrator.store.task_acts, at.plain_id(process_id))
        return json_response(documents(TaskComment, (act for act in acts if act.kind == "comment")))


def _urn(at: Components, task_id: str) -> str:
    return at.settings.entity_id("Task", task_id)


def _form(at: Components, task: TaskRecord, typed: dict[str, Any] | None = None) -> TaskForm | None:
    state = at.orchestrator.state
    process = state.active_processes.processes.get(task.process)
    is_open = process is not None and task.id in process.tasks
    data = process.form_data(task) if process is not None and is_open else {}
    return resolved_form(task, state.allocator.forms, {**data, **(typed or task.outputs or {})})


async def _details(at: Components, task_id: str) -> TaskDetails:
    store, registry = at.orchestrator.store, at.orchestrator.state.registry
    task = await at.orchestrator.tasklist.task(task_id)
    seen = await at.orchestrator.on_disk(store.everything, task.process)
    acts = await at.orchestrator.on_disk(store.task_acts, task.process)
    if seen is None:
        raise Problem.translated(404, "No such task", "tasklist.gone", "the process of this task is deleted")
    record, tasks, moves = seen
    deployed = registry.record(record.definition, record.version)
    await registry.prepare(deployed)
    activity = registry.plan_of(deployed).definition.activities().get(task.element)
    own = [act for act in acts if act.task == task.id]
    earlier = [
        other
        for other in tasks
        if (other.element, other.token) == (task.element, task.token) and other.visit < task.visit
    ]
    return task_details(
        task,
        record,
        deployed.title,
        activity,
        process_name=process_name(registry, record),
        resolved=None if task.status in {TaskStatus.COMPLETED, TaskStatus.FAILED} else _form(at, task),
        acts=own,
        history=task_history(task, earlier, [move for move in moves if move.task == task.id], acts),
    )
