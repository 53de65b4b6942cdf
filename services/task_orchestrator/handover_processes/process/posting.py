"""Posting: Tasks for the open activities of a process, and the activities that wait for a performer."""

from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime

from handover.messages import text_of
from handover_bpmn.execution.queries import OpenActivity
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.span_places import SpanPlace
from handover_bpmn.languages.base import ExpressionError
from handover_datamodels.entities import TaskStatus
from handover_processes.allocation.allocator import NoPerformer
from handover_processes.allocation.assignment import PerformerAssignment
from handover_processes.process import attempts
from handover_processes.process.process_state import ProcessState
from handover_processes.process.task_creation import create_task, with_form_version
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import ReservationRecord, ReservationState, Unallocated
from handover_processes.records.step import Step


def resume_waiting(process: ProcessState, run: Run) -> None:
    """Let the activities that wait for a performer wait again."""
    for waiting in process.record.unallocated:
        places = run.places(waiting.token)
        if run.visit(waiting.token) != waiting.visit or process.reservations.obstacle(places) is not None:
            continue
        open_ = run.open_activity(waiting.token, waiting.since)
        with suppress(ExpressionError):  # it becomes an incident when it is tried again
            assignment = _request(process, open_)
            request = assignment.waiting_request
            if request is not None:
                within = process.reservations.within(places).holders
                process.allocator.add_waiting(
                    process.record.id, waiting.token, request, waiting.since, within
                )
    process.allocator.has_changed = True


def can_continue(process: ProcessState, run: Run, waiting: Unallocated, now: datetime) -> bool:
    """Return whether there is news of an activity that waits for a performer."""
    places = run.places(waiting.token)
    if run.visit(waiting.token) != waiting.visit or process.reservations.obstacle(places) is not None:
        return False
    try:
        choice = _choose(process, run.open_activity(waiting.token, waiting.since), places, waiting.since, now)
    except ExpressionError:
        return True
    if not isinstance(choice, NoPerformer) or choice.is_final:
        return True
    # The holder of a named resource changes often; `reservations` show it.
    return choice.request.resource is None and choice.reason != waiting.reason


def post_open(process: ProcessState, run: Run, step: Step, now: datetime) -> None:
    """Post Tasks for the open activities without one, or let them wait for a performer or a reservation."""
    postponed = {(retry.token, retry.visit) for retry in process.record.retries if retry.due is not None}
    is_paused = process.record.status is TaskStatus.PAUSED
    unposted = [token for token, visit in process.open_tasks.unposted if (token, visit) not in postponed]
    process.reservations.update(run, unposted, now, reserves=not is_paused)
    if is_paused:
        process.reservations.pause()
        for waits in process.record.unallocated:
            process.allocator.remove_waiting(process.record.id, waits.token)
        return
    since = {
        (unallocated.token, unallocated.visit): unallocated.since
        for unallocated in process.record.unallocated
    }
    waiting: list[Unallocated] = []
    for token, visit in list(process.open_tasks.unposted):
        if (token, visit) in postponed or run.visit(token) != visit:
            continue
        try:
            began = since.get((token, visit), now)
            open_ = run.open_activity(token, began)
            places = run.places(token)
            obstacle = process.reservations.obstacle(places)
            if obstacle is not None:
                waiting.append(_wait_for(process, open_, obstacle, began))
                continue
            choice = _choose(process, open_, places, began, now)
            if isinstance(choice, NoPerformer):
                waiting.append(_wait(process, open_, places, choice, began))
            else:
                _post(process, open_, choice, step, now)
        except (ExpressionError, ValueError) as error:
            run.refuse(token, text_of(error), now)
    if waiting or since:
        record_waiting(process, waiting)


def _choose(
    process: ProcessState, open_: OpenActivity, places: Sequence[SpanPlace], since: datetime, now: datetime
) -> PerformerAssignment | NoPerformer:
    assignment = _request(process, open_)
    key = process.record.id, open_.token
    return process.allocator.choose(assignment, key, since, now, process.reservations.within(places))


def _request(process: ProcessState, open_: OpenActivity) -> PerformerAssignment:
    declined = attempts.declined_by(process.record, open_)
    return process.allocator.rules.request(open_.activity, open_.variables, declined)


def _wait(
    process: ProcessState,
    open_: OpenActivity,
    places: Sequence[SpanPlace],
    no_performer: NoPerformer,
    since: datetime,
) -> Unallocated:
    """Let an activity wait; raise `ValueError` if that would be useless."""
    if no_performer.is_final:
        raise ValueError(no_performer.reason)
    within = process.reservations.within(places).holders
    process.allocator.add_waiting(process.record.id, open_.token, no_performer.request, since, within)
    return Unallocated(
        open_.token, open_.visit, open_.element, open_.activity.name, no_performer.reason, since
    )


def _wait_for(
    process: ProcessState, open_: OpenActivity, reservation: ReservationRecord, since: datetime
) -> Unallocated:
    """Let an activity wait for a reservation; raise `ValueError` if that is impossible."""
    if reservation.state is ReservationState.IMPOSSIBLE:
        raise ValueError(reservation.reason)
    process.allocator.remove_waiting(process.record.id, open_.token)
    reason = reservation.reason
    return Unallocated(open_.token, open_.visit, open_.element, open_.activity.name, reason, since)


def record_waiting(process: ProcessState, waiting: Sequence[Unallocated]) -> None:
    """Record the activities that wait for a performer."""
    tokens = {activity.token for activity in waiting}
    for activity in process.record.unallocated:
        if activity.token not in tokens:
            process.allocator.remove_waiting(process.record.id, activity.token)
    process.revise(unallocated=tuple(waiting))


def _post(
    process: ProcessState, open_: OpenActivity, assignment: PerformerAssignment, step: Step, now: datetime
) -> None:
    activity = with_form_version(
        assignment.activity, process.record, process.allocator.forms, process.library, now
    )
    task, row = create_task(process.settings, process.record, open_, assignment, activity=activity, now=now)
    step.new.add(task.id)
    process.composed.append(task.id)
    process.record_task(task, step)
    if row is None:
        step.enqueue(task.stream, MessageKind.CREATE, task.id, task.entity)
    else:
        step.enqueue(task.stream, MessageKind.SPECIFY, task.id, {"row": row, "task": task.entity})
