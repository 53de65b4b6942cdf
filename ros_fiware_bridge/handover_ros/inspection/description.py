"""Describes what a mapping does, and which rules the present graph keeps from working."""

import re
from collections.abc import Iterator

from handover_ros.graph.port import ActionInfo, Endpoint, RosGraph, ServiceInfo
from handover_ros.mapping.model import RosToNgsild, ServiceCall
from handover_ros.mapping.values import MADE_OF, Source
from handover_ros.rules.plan import Plan, PlannedRequest, PlannedRosToNgsild

CHANGE_QOS = "change qos of the rule"


def lines(plan: Plan) -> Iterator[str]:
    """Yield a description of each rule."""
    for planned in plan.ros_to_ngsild:
        yield from _topic_rule(plan, planned)
    for to_ros in plan.ngsild_to_ros:
        chosen = to_ros.selector
        whom = chosen.id or f"entities of type {chosen.type}"
        also = f" that match {chosen.id_pattern or chosen.q}" if chosen.id_pattern or chosen.q else ""
        yield f"{to_ros.name}: {whom}{also} -> {to_ros.rule.topic} ({to_ros.rule.type}; {to_ros.qos})"
        for path, source in to_ros.rule.fields.items():
            yield f"    {path} = {_source(source)}"
        if to_ros.at_start:
            yield "    the state in the broker is published at the start"
    for asked in plan.requests:
        yield _request(asked)
    for served in plan.served_services:
        yield (
            f"{served.name}: a call of {served.rule.service} ({served.rule.type}) requests a Task of "
            f"{' and '.join(served.resources)}; the response is sent once the Task is {served.rule.answer}"
        )
    watched = plan.watched()
    both = {name for extractor in plan.ros_to_ngsild for name in extractor.rule.attributes} & watched
    if both:
        yield f"both ways: {', '.join(sorted(both))}; a value is not sent back to the side it came from"
    if not list(plan.names()):
        yield "no rules"


def problems(plan: Plan, graph: RosGraph) -> Iterator[str]:
    """Yield the reasons why rules do not work with the present graph."""
    topics = {topic.name: topic for topic in graph.topics()}
    for planned in plan.ros_to_ngsild:
        pattern = planned.pattern or re.compile(re.escape(planned.rule.topic))
        fitting = [topic for name, topic in topics.items() if pattern.fullmatch(name)]
        speakers = [publisher for topic in fitting for publisher in topic.publishers if not publisher.ours]
        if not speakers:
            yield f"{planned.name}: no node publishes {planned.rule.topic} now"
        type_name = planned.extractor.type_name if planned.extractor else None
        for publisher in speakers:
            if (
                type_name is not None
                and (why := _other_type(plan, type_name, publisher, "publishes")) is not None
            ):
                yield f"{planned.name}: {why}"
            qos = planned.reader_qos(other.qos for other in speakers)
            if (unmet := qos.unmet(publisher.qos)) is not None:
                yield f"{planned.name}: {publisher.shown_node} will not be received: {unmet}; {CHANGE_QOS}"
    for to_ros in plan.ngsild_to_ros:
        topic = topics.get(to_ros.rule.topic.with_settings(plan.settings).constant or "")
        for subscriber in topic.subscribers if topic else ():
            if (
                not subscriber.ours
                and (why := _other_type(plan, to_ros.rule.type, subscriber, "subscribes to")) is not None
            ):
                yield f"{to_ros.name}: {why}"
            if not subscriber.ours and (unmet := subscriber.qos.unmet(to_ros.qos)) is not None:
                node = subscriber.shown_node
                yield f"{to_ros.name}: {node} will not receive messages: {unmet}; {CHANGE_QOS}"
    for asked in plan.requests:
        yield from _request_problems(asked, graph)


def _other_type(plan: Plan, type_name: str, peer: Endpoint, does: str) -> str | None:
    if peer.type_name != type_name:
        return f"{peer.shown_node} {does} {peer.type_name}, not {type_name}; give the rule that type"
    ours = plan.definitions.hash(type_name)
    if peer.type_hash is None or peer.type_hash == ours:
        return None
    return (
        f"{peer.shown_node} {does} another definition of {type_name} (its hash is {peer.type_hash}, ours is "
        f"{ours}); name the files of its definition in type_paths"
    )


def _request_problems(asked: PlannedRequest, graph: RosGraph) -> Iterator[str]:
    """Yield the reasons why a service or action cannot be called."""
    rule = asked.rule
    if isinstance(rule, ServiceCall):
        name, carrier, type_name = rule.service, rule.service, rule.type
        services: list[ServiceInfo | ActionInfo] = [
            service for service in graph.services() if service.name == name
        ]
    else:
        name, carrier, type_name = rule.action, f"{rule.action}/_action/send_goal", f"{rule.type}_SendGoal"
        services = [action for action in graph.actions() if action.name == name]
    if not any(service.servers for service in services):
        yield f"{asked.name}: no node serves {name} now"
        return
    others = sorted({kind for service in services for kind in service.type_names} - {rule.type})
    if others:
        theirs = " and ".join(others)
        yield f"{asked.name}: {name} has the type {theirs}, not {rule.type}; give the rule that type"
        return
    for problem in graph.obstacles(carrier, type_name):
        yield f"{asked.name}: {problem}"


def _topic_rule(plan: Plan, planned: PlannedRosToNgsild) -> Iterator[str]:
    rule = planned.rule
    to = str(rule.entity.id.with_settings(plan.settings)) if rule.entity else "an Alert"
    kind = planned.extractor.type_name if planned.extractor else "type unknown: no node publishes it"
    qos = f"as published, keep_last {planned.qos.depth}" if planned.match else str(planned.qos)
    yield f"{planned.name}: {rule.topic} ({kind}; {qos}) -> {to}{_rate(rule)}"
    made = planned.extractor.attributes if planned.extractor else ()
    for attribute in made:
        asked = rule.attributes[attribute.name]
        of = next(getattr(asked, key) for key in MADE_OF if key in asked.model_fields_set)
        shown = ", ".join(map(str, of)) if isinstance(of, tuple) else of
        unit = f", {asked.convert}" if asked.convert else ""
        code = f" [{attribute.unit_code}]" if attribute.unit_code else ""
        yield f"    {attribute.name} ({attribute.kind}) = {shown}{unit}{code}"
    if rule.alert is not None:
        yield f"    {rule.alert.key} about {rule.alert.about.id.with_settings(plan.settings)}"


def _source(source: Source) -> str:
    if source.json_fields is not None:
        members = ", ".join(f"{name}: {path}" for name, path in source.json_fields.items())
        return f"JSON of {members}"
    settings = {key: getattr(source, key) for key in source.model_fields_set if key != "values"}
    return ", ".join(
        str(value) if key in {"attribute", "text"} else f"{key} {value}" for key, value in settings.items()
    )


def _rate(rule: RosToNgsild) -> str:
    banded = rule.dead_band or any(attribute.dead_band for attribute in rule.attributes.values())
    parts = [
        f"every {rule.every_ms} ms at most" if rule.every_ms else "",
        "on change" if rule.on_change or banded else "",
        f"every {rule.at_least_every_s:g} s at least" if rule.at_least_every_s else "",
        f"the last {rule.buffer.keep} kept while the broker is unavailable" if rule.buffer.keep > 1 else "",
        "" if rule.create else "only existing entities",
    ]
    words = ", ".join(filter(None, parts))
    return f", {words}" if words else ""


def _request(asked: PlannedRequest) -> str:
    rule = asked.rule
    does = f"calls {rule.service}" if isinstance(rule, ServiceCall) else f"sends a goal to {rule.action}"
    if rule.task is not None:
        return f"{asked.name}: a Task {rule.task} of {asked.resource} {does} ({rule.type})"
    whom = (asked.selector.id or asked.selector.type) if asked.selector else ""
    when = rule.when.attribute if rule.when else ""
    return f"{asked.name}: a change of {when} of {whom} {does} ({rule.type})"
