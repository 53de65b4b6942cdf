"""Names of BPMN's XML: namespaces, and how big a file may be."""

from lxml import etree

BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"
HANDOVER = "urn:handover:bpmn"
MAX_BYTES = 1024 * 1024
MAX_ELEMENTS = 20_000


def qualified(name: str) -> str:
    """Return a BPMN element's name as lxml writes it."""
    return f"{{{BPMN}}}{name}"


def local(element: etree._Element) -> str:
    """Return an element's name without its namespace."""
    return str(etree.QName(element).localname)
