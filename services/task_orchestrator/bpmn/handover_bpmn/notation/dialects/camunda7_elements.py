"""Elements of Camunda 7: those of its namespace and of its relatives."""

from collections.abc import Iterator

from lxml import etree

from handover_bpmn.notation.document import extensions, local, namespace, text

NAMESPACES = (
    "http://camunda.org/schema/1.0/bpmn",
    "http://activiti.org/bpmn",
    "http://flowable.org/bpmn",
    "http://operaton.org/schema/1.0/bpmn",
    "http://camunda.org/bpmn",
)


def has_expression(text: str) -> bool:
    """Return whether a text contains JUEL."""
    return "${" in text or "#{" in text


def own_extensions(element: etree._Element) -> Iterator[etree._Element]:
    """Yield the extension elements of Camunda 7 and its relatives."""
    for extension in extensions(element):
        if namespace(extension) in NAMESPACES:
            yield extension


def extensions_named(element: etree._Element, name: str) -> Iterator[etree._Element]:
    """Yield those extension elements of an element that have a name."""
    return (extension for extension in own_extensions(element) if local(extension) == name)


def children_named(element: etree._Element, name: str) -> Iterator[etree._Element]:
    """Yield the child elements of these namespaces that have a name."""
    for part in element.iterchildren("{*}*"):
        if local(part) == name and namespace(part) in NAMESPACES:
            yield part


def own_child_text(element: etree._Element, name: str) -> str:
    """Return the text of the first child element with a name; empty without one."""
    return next((text(part) for part in children_named(element, name)), "")
