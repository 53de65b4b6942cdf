"""Explaining: what a mapping would do, in sentences; and how it meets the graph that is there."""

from collections.abc import Iterator

from ros_fiware_bridge.graph.port import RosGraph
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
        topic = topics.get(outward.rule.topic)
        speakers = [one for one in topic.publishers if not one.ours] if topic else []
        if not speakers:
            yield f"{outward.name}: nobody publishes {outward.rule.topic} now"
        type_name = outward.outward.type_name if outward.outward else None
        for one in speakers:
            if type_name is not None and one.type_name != type_name:
                yield f"{outward.name}: {one.node} publishes {one.type_name}, not {type_name}"
            if (unmet := outward.qos.unmet(one.qos)) is not None:
                yield f"{outward.name}: {one.node} will not be heard: {unmet}; change qos of the rule"
    services = {one.name for one in graph.services() if one.servers}
    actions = {one.name for one in graph.actions() if one.servers}
    for asked in plan.asks:
        rule = asked.rule
        what = rule.service if isinstance(rule, ServiceCall) else rule.action
        if what not in (services if isinstance(rule, ServiceCall) else actions):
            yield f"{asked.name}: nobody serves {what} now"


def _outward(plan: Plan, planned: PlannedOutward) -> Iterator[str]:
    rule = planned.rule
    to = str(rule.entity.id.with_settings(plan.settings)) if rule.entity else "an Alert"
    kind = planned.outward.type_name if planned.outward else "type still unknown: nobody publishes it"
    yield f"{planned.name}: {rule.topic} ({kind}; {planned.qos}) -> {to}{_pace(rule)}"
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
