"""Explaining: what a mapping would do, in sentences; and how it meets the graph that is there."""

import re
from collections.abc import Iterator

from ros_fiware_bridge.graph.port import ActionInfo, Endpoint, RosGraph, ServiceInfo
from ros_fiware_bridge.mapping.model import RosToNgsild, ServiceCall
from ros_fiware_bridge.mapping.values import MADE_OF, Source
from ros_fiware_bridge.rules.plan import Plan, PlannedAsk, PlannedOutward


def lines(plan: Plan) -> Iterator[str]:
    """Yield what each rule would do."""
    for outward in plan.outward:
        yield from _outward(plan, outward)
    for inward in plan.inward:
        chosen = inward.selector
        whom = chosen.id or f"entities of type {chosen.type}"
        also = f" that match {chosen.id_pattern or chosen.q}" if chosen.id_pattern or chosen.q else ""
        yield f"{inward.name}: {whom}{also} -> {inward.rule.topic} ({inward.rule.type}; {inward.qos})"
        for path, source in inward.rule.fields.items():
            yield f"    {path} = {_source(source)}"
        if inward.at_start:
            yield "    what the broker holds is said at the start"
    for asked in plan.asks:
        yield _asked(asked)
    for offer in plan.offers:
        yield (
            f"{offer.name}: whoever calls {offer.rule.service} ({offer.rule.type}) asks "
            f"{' and '.join(offer.resources)} for a Task; answered once it is {offer.rule.answer}"
        )
    watched = plan.watched()
    both = {name for one in plan.outward for name in one.rule.attributes} & watched
    if both:
        yield f"both ways: {', '.join(sorted(both))}; what comes from one side is not sent back to it"
    if not list(plan.names()):
        yield "no rules"


def against(plan: Plan, graph: RosGraph) -> Iterator[str]:
    """Yield what about the graph that is there would keep rules from working."""
    topics = {topic.name: topic for topic in graph.topics()}
    for outward in plan.outward:
        pattern = outward.pattern or re.compile(re.escape(outward.rule.topic))
        fitting = [topic for name, topic in topics.items() if pattern.fullmatch(name)]
        speakers = [one for topic in fitting for one in topic.publishers if not one.ours]
        if not speakers:
            yield f"{outward.name}: nobody publishes {outward.rule.topic} now"
        type_name = outward.outward.type_name if outward.outward else None
        for one in speakers:
            if type_name is not None and (why := _other_type(plan, type_name, one, "publishes")) is not None:
                yield f"{outward.name}: {why}"
            qos = outward.reader_qos(other.qos for other in speakers)
            if (unmet := qos.unmet(one.qos)) is not None:
                yield f"{outward.name}: {one.node} will not be heard: {unmet}; change qos of the rule"
    for inward in plan.inward:
        topic = topics.get(inward.rule.topic.with_settings(plan.settings).constant or "")
        for one in topic.subscribers if topic else ():
            if (
                not one.ours
                and (why := _other_type(plan, inward.rule.type, one, "subscribes to")) is not None
            ):
                yield f"{inward.name}: {why}"
            if not one.ours and (unmet := one.qos.unmet(inward.qos)) is not None:
                yield f"{inward.name}: {one.node} will not hear it: {unmet}; change qos of the rule"
    for asked in plan.asks:
        yield from _unasked(asked, graph)


def _other_type(plan: Plan, type_name: str, peer: Endpoint, does: str) -> str | None:
    if peer.type_name != type_name:
        return f"{peer.node} {does} {peer.type_name}, not {type_name}; give the rule that type"
    ours = plan.definitions.hash(type_name)
    if peer.type_hash is None or peer.type_hash == ours:
        return None
    return (
        f"{peer.node} {does} another definition of {type_name} (its hash is {peer.type_hash}, ours is "
        f"{ours}); name the files of its definition in type_paths"
    )


def _unasked(asked: PlannedAsk, graph: RosGraph) -> Iterator[str]:
    """Yield what keeps a service or action from being called."""
    rule = asked.rule
    if isinstance(rule, ServiceCall):
        name, carrier, type_name = rule.service, rule.service, rule.type
        found: list[ServiceInfo | ActionInfo] = [one for one in graph.services() if one.name == name]
    else:
        name, carrier, type_name = rule.action, f"{rule.action}/_action/send_goal", f"{rule.type}_SendGoal"
        found = [one for one in graph.actions() if one.name == name]
    if not any(one.servers for one in found):
        yield f"{asked.name}: nobody serves {name} now"
        return
    others = sorted({kind for one in found for kind in one.type_names} - {rule.type})
    if others:
        theirs = " and ".join(others)
        yield f"{asked.name}: {name} has the type {theirs}, not {rule.type}; give the rule that type"
        return
    for problem in graph.obstacles(carrier, type_name):
        yield f"{asked.name}: {problem}"


def _outward(plan: Plan, planned: PlannedOutward) -> Iterator[str]:
    rule = planned.rule
    to = str(rule.entity.id.with_settings(plan.settings)) if rule.entity else "an Alert"
    kind = planned.outward.type_name if planned.outward else "type still unknown: nobody publishes it"
    qos = f"as published, keep_last {planned.qos.depth}" if planned.match else str(planned.qos)
    yield f"{planned.name}: {rule.topic} ({kind}; {qos}) -> {to}{_pace(rule)}"
    made = planned.outward.attributes if planned.outward else ()
    for attribute in made:
        asked = rule.attributes[attribute.name]
        of = next(getattr(asked, one) for one in MADE_OF if one in asked.model_fields_set)
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
    said = {key: getattr(source, key) for key in source.model_fields_set if key != "values"}
    return ", ".join(
        str(value) if key in {"attribute", "text"} else f"{key} {value}" for key, value in said.items()
    )


def _pace(rule: RosToNgsild) -> str:
    banded = rule.dead_band or any(one.dead_band for one in rule.attributes.values())
    said = [
        f"every {rule.every_ms} ms at most" if rule.every_ms else "",
        "on change" if rule.on_change or banded else "",
        f"every {rule.at_least_every_s:g} s at least" if rule.at_least_every_s else "",
        f"the last {rule.buffer.keep} kept while the broker is away" if rule.buffer.keep > 1 else "",
        "" if rule.create else "only entities that are there",
    ]
    words = ", ".join(one for one in said if one)
    return f", {words}" if words else ""


def _asked(asked: PlannedAsk) -> str:
    rule = asked.rule
    does = f"calls {rule.service}" if isinstance(rule, ServiceCall) else f"sends a goal to {rule.action}"
    if rule.task is not None:
        return f"{asked.name}: a Task {rule.task} of {asked.resource} {does} ({rule.type})"
    whom = (asked.selector.id or asked.selector.type) if asked.selector else ""
    when = rule.when.attribute if rule.when else ""
    return f"{asked.name}: a change of {when} of {whom} {does} ({rule.type})"
