"""Escalations: what happens when the Task of an activity is not completed in time, in several levels.

<handover:escalation after="PT15M" group="shift-leads"/>
<handover:escalation after="PT1H" code="late"/>
"""

from functools import partial

from lxml import etree

from handover.formats.durations import parse_duration
from handover_bpmn.model import Escalation
from handover_bpmn.notation.dialects.base import attempt
from handover_bpmn.notation.dialects.handover_elements import extensions_of
from handover_bpmn.notation.faults import Findings


def read_escalations(element: etree._Element, findings: Findings) -> tuple[Escalation, ...]:
    """Return the escalations of an activity, the earliest first."""
    extensions = extensions_of(element, "escalation", findings)
    read = [attempt(extension, partial(_read, extension), None, findings) for extension in extensions]
    levels = [level for level in read if level is not None]
    return tuple(sorted(levels, key=lambda level: level.after.nominal_s))


def _read(extension: etree._Element) -> Escalation:
    code = (extension.get("code") or "").strip() or None
    group = (extension.get("group") or "").strip() or None
    if code is None and group is None:
        raise ValueError("a handover:escalation has the code of a BPMN escalation, or a group, or both")
    return Escalation(parse_duration((extension.get("after") or "PT0S").strip()), code, group)
