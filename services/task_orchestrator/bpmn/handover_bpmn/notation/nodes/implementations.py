"""Implementations: whether somebody has to send a message, which is then a Task."""

from lxml import etree

from handover.messages import message
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.handover_elements import has_task


def has_implementation(element: etree._Element, context: Context) -> bool:
    """Return whether somebody does the work of an element."""
    return has_task(element) or context.dialects.main.work(element, context.findings).has_implementation


def warn_message_not_thrown(element: etree._Element, context: Context) -> None:
    """Warn that the performer has to send the message along a message flow."""
    if element.get("id") in context.collaboration.connected:
        context.findings.warn(
            element,
            message(
                "bpmn.message_sent_by_performer",
                "the performer of its Task has to send the message along the message flow; "
                "without an implementation it is sent here",
            ),
        )
