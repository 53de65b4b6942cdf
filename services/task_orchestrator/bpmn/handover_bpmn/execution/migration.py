"""Migration: a run continues in another version of its definition.

Each token stays in its state, at the element of the same id or at the one that the mapping names. What runs
or waits there continues: Tasks, called processes, and the waits for events that are the same in both
versions. A wait for an event that differs is created again, at the moment of the migration. A token whose
element is missing, is in another scope or is of another kind is an obstacle.

A called process is migrated with its caller to the version that the new call activity names, unless one of
its tokens cannot continue there; then it keeps its version.

`migrate` changes the state that it is given, also if it finds obstacles: the caller then discards the state.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from handover.messages import Message, message, text_of
from handover_bpmn.execution.activities import called_plan
from handover_bpmn.execution.comparison import comparable, difference, nodes_ahead, read_by, set_by
from handover_bpmn.execution.graph import Graph, Plan
from handover_bpmn.execution.machine import Machine
from handover_bpmn.execution.state import Completion, Frame, RunFailed, Token, TokenState, Wait, prefix_within
from handover_bpmn.execution.waits import add_wait
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import Kind, Node, Scope

_HAS_BEGUN = frozenset(
    {
        *(TokenState.WORK, TokenState.WAITING, TokenState.SCOPE, TokenState.LOOP),
        *(TokenState.FINISHING, TokenState.LEAVING),
    }
)
"""States, and stages of incidents, in which the boundary events of an activity are waited for."""
_IDENTITY = frozenset({"id", "name", "description"})


@dataclass(frozen=True, slots=True)
class Finding:
    """What differs for an element of the run; an obstacle prevents the migration.

    `element` is the path of the element in the present version, `token` the token there, if it has one.
    """

    element: str
    name: str
    reason: Message
    is_obstacle: bool = False
    token: str | None = None
    target: str | None = None
    """The element of the new version, if it has another id."""


@dataclass(frozen=True, slots=True)
class _Scopes:
    """The scope of a frame in the present version and in the new one."""

    old: Graph
    new: Graph


class Migration:
    """One migration of the state of a machine from the plan `old` to `new`."""

    def __init__(self, machine: Machine, old: Plan, new: Plan, mapping: Mapping[str, str]) -> None:
        self._machine = machine
        self._state = machine.state
        self._old = old
        self._new = new
        self._mapping = mapping
        self._places = {node: scope.id for scope in new.definition.scopes() for node in scope.nodes}
        self._scopes: dict[int, _Scopes] = {}
        self._old_ids: dict[int, str] = {}
        """Token -> the id of its element in the present version."""
        self.findings: list[Finding] = []

    def apply(self) -> list[Finding]:
        """Change the state and return what differs; with an obstacle the state must be discarded."""
        self._check_mapping()
        missing = self._missing_variables()
        self._link_frames()
        if not any(finding.is_obstacle for finding in self.findings):
            self._add_parameters()
            for frame_id, scopes in self._scopes.items():
                self._migrate_frame(self._state.frames[frame_id], scopes)
            self._rename_visits()
            self._report_variables(missing)
        return self.findings

    def _target(self, element: str) -> str:
        return self._mapping.get(element, element)

    def _check_mapping(self) -> None:
        old_ids = {name for scope in self._old.definition.scopes() for name in _ids(scope)}
        new_ids = {name for scope in self._new.definition.scopes() for name in _ids(scope)}
        for source, target in self._mapping.items():
            for name, expected, version in (
                (source, old_ids, self._old.version),
                (target, new_ids, self._new.version),
            ):
                if name not in expected:
                    reason = message(
                        "migration.unknown_element",
                        'the mapping names "{name}", which version {version} does not have',
                        name=name,
                        version=version,
                    )
                    self.findings.append(Finding(source, source, reason, True, target=target))

    # Tokens

    def _link_frames(self) -> None:
        """Find the new scope of each frame, the outer ones first, and move the tokens to the new ids."""
        state = self._state
        for frame in state.frames.values():
            host = None if frame.host is None else state.tokens[frame.host]
            if host is None:
                self._scopes[frame.id] = _Scopes(frame.graph, self._new.graph)
            elif frame.process is None and host.frame in self._scopes:
                inner = self._scopes[host.frame].new.inner.get(host.node)
                if inner is None:  # an obstacle of its host
                    continue
                self._scopes[frame.id] = _Scopes(frame.graph, inner)
            elif frame.process is not None and host.frame in self._scopes:
                called = self._called(frame, host)
                if called is None:
                    continue
                self._scopes[frame.id] = _Scopes(frame.graph, called.graph)
                frame.process = (called.definition.name, called.version)
            else:  # within a called process that keeps its version
                continue
            scopes = self._scopes[frame.id]
            for token in frame.tokens.values():
                self._move_token(frame, token, scopes)
        for frame_id, scopes in self._scopes.items():
            frame = state.frames[frame_id]
            frame.graph, frame.scope = scopes.new, scopes.new.scope.id
        root = state.root
        root.process = (self._new.definition.name, self._new.version)
        for frame in state.frames.values():
            if frame.host is not None:
                host = state.tokens[frame.host]
                frame.prefix = prefix_within(
                    state.frames[host.frame], host, is_call=frame.process is not None
                )

    def _called(self, frame: Frame, host: Token) -> Plan | None:
        """Return the version in which a called process continues; None if it keeps its own."""
        assert frame.process is not None  # noqa: S101 - it is called
        name, version = frame.process
        outer = self._state.frames[host.frame]
        scopes = self._scopes[host.frame]
        node = scopes.new.nodes.get(host.node)
        if node is None or node.call is None or host.id not in self._old_ids:
            return None  # an obstacle of its host
        before = scopes.old.nodes[self._old_ids[host.id]]
        try:
            plan = called_plan(self._machine, node.call, self._machine.frame_variables(outer))
        except (ExpressionError, ValueError, RunFailed) as error:
            if comparable(before.call) == comparable(node.call):  # else the difference is reported
                self._keep_called(outer, host, before, frame, text_of(error))
            return None
        if plan.definition.name != name or plan.version == version:
            return None
        reason = self._why_kept(frame, plan.graph)
        if reason is not None:
            self._keep_called(outer, host, before, frame, reason)
            return None
        obstacle = message(
            "migration.called_too",
            'the called process "{name}" continues in version {version}',
            name=name,
            version=plan.version,
        )
        self._find(outer, host, before, obstacle, target=host.node)
        return plan

    def _keep_called(self, outer: Frame, host: Token, node: Node, frame: Frame, why: str) -> None:
        assert frame.process is not None  # noqa: S101 - it is called
        reason = message(
            "migration.called_keeps",
            'the called process "{name}" keeps version {version}: {why}',
            name=frame.process[0],
            version=frame.process[1],
            why=why,
        )
        self._find(outer, host, node, reason, target=host.node)

    def _why_kept(self, frame: Frame, graph: Graph) -> str | None:
        """Return why a token of a called process, or of its subprocesses, cannot continue in `graph`."""
        for token in frame.tokens.values():
            old, new = frame.graph.nodes[token.node], graph.nodes.get(self._target(token.node))
            if new is None:
                return message(
                    "migration.called_lacks", 'its new version has no element "{element}"', element=token.node
                )
            obstacle = _obstacle(old, new, token)
            if obstacle is not None:
                return f"{old.name or old.id}: {obstacle}"
            for inner in self._state.frames.values():
                if inner.host == token.id and inner.process is None:
                    within = graph.inner.get(new.id)
                    why = None if within is None else self._why_kept(inner, within)
                    if why is not None:
                        return why
        return None

    def _move_token(self, frame: Frame, token: Token, scopes: _Scopes) -> None:
        old = scopes.old.nodes[token.node]
        target = self._target(token.node)
        new = scopes.new.nodes.get(target)
        obstacle = self._missing_element(target) if new is None else _obstacle(old, new, token)
        if obstacle is not None:
            self._find(frame, token, old, obstacle, target=target, is_obstacle=True)
            return
        assert new is not None  # noqa: S101 - else it is an obstacle
        self._old_ids[token.id] = old.id
        token.node = target
        if token.via is not None:
            token.via = self._target(token.via)
        is_open = token.state is TokenState.WORK
        if is_open and comparable(old.activity, but=_IDENTITY) != comparable(new.activity, but=_IDENTITY):
            reason = message(
                "migration.activity_changed",
                "its activity has changed; the open Task stays as it is, and the next one is as changed",
            )
            self._find(frame, token, old, reason, target=target)
        elif token.state is TokenState.SCOPE and comparable(old.call) != comparable(new.call):
            reason = message(
                "migration.call_changed", "it calls differently; the called process that runs continues"
            )
            self._find(frame, token, old, reason, target=target)

    def _missing_element(self, target: str) -> Message:
        scope = self._places.get(target)
        if scope is None:
            return message(
                "migration.no_element",
                'version {version} has no element "{target}"; map it to another one, or move the token first',
                version=self._new.version,
                target=target,
            )
        return message(
            "migration.other_scope",
            '"{target}" is in the scope "{scope}" of version {version}; move the token elsewhere first',
            version=self._new.version,
            target=target,
            scope=scope,
        )

    def _find(
        self,
        frame: Frame,
        token: Token | None,
        node: Node,
        reason: Message,
        *,
        target: str | None = None,
        is_obstacle: bool = False,
    ) -> None:
        self.findings.append(
            Finding(
                frame.prefix + node.id,
                node.name,
                reason,
                is_obstacle,
                None if token is None else str(token.id),
                None if target == node.id else target,
            )
        )

    # Frames

    def _migrate_frame(self, frame: Frame, scopes: _Scopes) -> None:
        for token in list(frame.tokens.values()):
            before = self._old_ids[token.id]
            events = _events_at(scopes.old, token, before), _events_at(scopes.new, token, token.node)
            self._migrate_waits(frame, token, *events)
            if token.inside is not None:
                inner = _Scopes(scopes.old.inner[before], scopes.new.inner[token.node])
                token.inside["completions"] = self._kept(frame, token.inside["completions"], inner)
            if token.compensation is not None:
                token.compensation.entries = [
                    (frame_id, kept)
                    for frame_id, entry in token.compensation.entries
                    if frame_id in self._scopes
                    for kept in self._kept(frame, [entry], self._scopes[frame_id])
                ]
        old_events = {start.id: start for _, start in scopes.old.event_subprocesses}
        new_events = {start.id: start for _, start in scopes.new.event_subprocesses}
        self._migrate_waits(frame, frame, old_events, new_events)
        frame.completions = self._kept(frame, frame.completions, scopes)
        self._migrate_data(frame, scopes)
        self._rejoin(frame, scopes)

    def _migrate_waits(
        self, frame: Frame, owner: Token | Frame, old: Mapping[str, Node], new: Mapping[str, Node]
    ) -> None:
        machine, token = self._machine, owner if isinstance(owner, Token) else None
        for wait in [self._state.waits[wait_id] for wait_id in owner.waits]:
            before = old[wait.node]
            after = new.get(self._target(wait.node))
            if after is None:
                reason = message("migration.no_longer_awaited", "the process no longer waits for this event")
                self._find(frame, token, before, reason)
                self._state.remove_wait(wait)
            elif comparable(before.event) == comparable(after.event):
                wait.node = after.id
            else:
                reason = message(
                    "migration.event_changed", "the event has changed; the process waits for it from now on"
                )
                self._find(frame, token, before, reason, target=after.id)
                self._state.remove_wait(wait)
                added = self._await(frame, owner, after)
                if added is not None and wait.stopped is not None:
                    added.stopped = wait.stopped
        targets = {self._target(name) for name in old}
        for event in new.values():
            if event.id in targets or not self._can_await(frame, owner):
                continue
            if self._await(frame, owner, event) is not None:
                reason = message("migration.newly_awaited", "the process waits for this event from now on")
                self._find(frame, token, event, reason)
        if token is not None and token.state is TokenState.WAITING and not owner.waits:
            node = machine.node(token)
            reason = message("migration.nothing_awaited", "nothing is left that the token waits for")
            self._find(frame, token, node, reason, is_obstacle=True)

    def _await(self, frame: Frame, owner: Token | Frame, event: Node) -> Wait | None:
        """Wait for an event; return None, with an obstacle if it is invalid, if that is impossible."""
        try:
            if not add_wait(self._machine, owner, event):
                return None
        except (ExpressionError, ValueError, OverflowError) as error:
            token = owner if isinstance(owner, Token) else None
            reason = message(
                "migration.event_fails",
                "the process cannot wait for this event: {error}",
                error=text_of(error),
            )
            self._find(frame, token, event, reason, is_obstacle=True)
            return None
        return self._state.waits[owner.waits[-1]]

    def _can_await(self, frame: Frame, owner: Token | Frame) -> bool:
        """Return whether events that are new in this version are waited for."""
        if isinstance(owner, Token):
            return (owner.state if owner.incident is None else owner.incident.stage) in _HAS_BEGUN
        host = self._machine.host(frame)
        if host is not None and host.state is not TokenState.SCOPE:  # it compensates
            return False
        return not any(
            start.interrupting
            for node, start in frame.graph.event_subprocesses
            for token in frame.tokens.values()
            if token.node == node.id
        )

    def _kept(self, frame: Frame, completions: Iterable[Completion], scopes: _Scopes) -> list[Completion]:
        """Return the completed activities that can still be compensated, with their new ids."""
        kept: list[Completion] = []
        for completion in completions:
            before = completion["activity"]
            target = self._target(before)
            if "inside" in completion:
                inner = scopes.new.inner.get(target)
                is_kept = inner is not None and before in scopes.old.inner
                if inner is not None and is_kept:
                    within = _Scopes(scopes.old.inner[before], inner)
                    completion["inside"]["completions"] = self._kept(
                        frame, completion["inside"]["completions"], within
                    )
            else:
                is_kept = target in scopes.new.handlers
            if is_kept:
                completion["activity"] = target
                kept.append(completion)
            else:
                reason = message(
                    "migration.not_compensated", "it has completed and is not compensated any more"
                )
                self._find(frame, None, scopes.old.nodes[before], reason)
        return kept

    def _migrate_data(self, frame: Frame, scopes: _Scopes) -> None:
        data = {}
        for name, value in frame.data.items():
            target = self._target(name)
            if target in scopes.new.scope.data_objects:
                data[target] = value
            else:
                reason = message("migration.no_data_object", "the data object is removed with its value")
                drawn = scopes.old.scope.data_objects.get(name, name)
                self.findings.append(Finding(frame.prefix + name, drawn, reason))
        frame.data = data

    def _rejoin(self, frame: Frame, scopes: _Scopes) -> None:
        """Let the tokens at joins with other incoming flows arrive again."""
        machine, changed = self._machine, []
        for token in frame.tokens.values():
            if token.state is not TokenState.JOINED:
                continue
            before = {self._target(flow.id) for flow in scopes.old.incoming[self._old_ids[token.id]]}
            after = {flow.id for flow in scopes.new.incoming[token.node]}
            if before != after or token.via not in after:
                changed.append(token)
            elif machine.node(token).kind is Kind.INCLUSIVE:
                machine.joins_to_check[frame.id, token.node] = None
        for token in changed:
            machine.change_state(token, TokenState.READY)

    # Variables

    def _missing_variables(self) -> set[str]:
        """Return the names that what follows reads, and that nothing has set or sets before."""
        nodes: dict[str, Node] = {}
        for frame in self._state.frames.values():
            if frame.process is None or frame is self._state.root:
                nodes |= self._read_but_not_set(frame)
        return set(nodes)

    def _add_parameters(self) -> None:
        """Set the parameters of the new version that the process does not have to their defaults."""
        root = self._state.root
        for parameter in self._new.definition.parameters.values():
            if parameter.name in root.variables:
                continue
            if parameter.required:
                reason = message(
                    "migration.missing_parameter",
                    'version {version} needs the parameter "{name}"; set it with the migration',
                    version=self._new.version,
                    name=parameter.name,
                )
                self.findings.append(Finding(self._new.definition.name, parameter.name, reason, True))
            else:
                self._machine.set_variables(root, {parameter.name: parameter.default})

    def _report_variables(self, before: set[str]) -> None:
        """Report the variables that what follows reads in the new version only."""
        for frame_id in self._scopes:
            frame = self._state.frames[frame_id]
            for name, node in self._read_but_not_set(frame).items():
                if name not in before:
                    reason = message(
                        "migration.missing_variable",
                        '"{name}" is read here, and the process does not have it yet',
                        name=name,
                    )
                    self._find(frame, None, node, reason)

    def _read_but_not_set(self, frame: Frame) -> dict[str, Node]:
        reads: dict[str, Node] = {}
        sets: set[str] = set()
        ahead = nodes_ahead(frame.graph, (token.node for token in frame.tokens.values()))
        for node, flows in ahead:
            for part in (node, *(flow.condition for flow in flows)):
                for name in read_by(part):
                    reads.setdefault(name, node)
            sets |= set(set_by(node))
        visible = self._machine.frame_variables(frame)
        for token in frame.tokens.values():
            sets |= token.local.keys()
        return {name: node for name, node in reads.items() if name not in sets and name not in visible}

    def _rename_visits(self) -> None:
        """Count the visits of renamed elements on, so that the ids of Tasks stay unique."""
        visits = self._state.visits
        for element, count in list(visits.items()):
            for source, target in self._mapping.items():
                if element == source or element.startswith(f"{source}."):
                    renamed = target + element[len(source) :]
                    visits[renamed] = max(visits.get(renamed, 0), count)


def _ids(scope: Scope) -> Iterator[str]:
    yield from scope.nodes
    yield from scope.flows
    yield from scope.data_objects


def _events_at(graph: Graph, token: Token, node_id: str) -> dict[str, Node]:
    """Return the events that a token at a node can wait for: its own, and the boundary events."""
    node = graph.nodes[node_id]
    events = (
        {}
        if token.body is not None
        else {boundary.id: boundary for boundary in graph.boundaries.get(node_id, [])}
    )
    if node.kind is Kind.EVENT_BASED:
        events |= {flow.target: graph.nodes[flow.target] for flow in graph.outgoing[node_id]}
    elif node.event is not None and node.kind in {Kind.CATCH_EVENT, Kind.RECEIVE_TASK}:
        events[node_id] = node
    return events


def _obstacle(old: Node, new: Node, token: Token) -> Message | None:
    """Return why a token at `old` cannot continue at `new`; None if it can."""
    enters_again = token.incident is not None and token.incident.stage is TokenState.READY
    if enters_again and new.kind is not Kind.BOUNDARY_EVENT and not new.triggered_by_event:
        return None
    return difference(old, new)
