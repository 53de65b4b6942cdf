"""The XML of a file: safe parsing, and access to elements.

Entities are not expanded, a DOCTYPE and network access are refused, and the size of a file, the number of its
elements and their depth are limited before anything else looks at them.
"""

import re
from collections.abc import Container, Iterator, Mapping

from lxml import etree

from handover.messages import message
from handover_bpmn.model import Fault
from handover_bpmn.notation.faults import BadBpmn

BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"
MAX_BYTES = 4 * 1024 * 1024
MAX_ELEMENTS = 40_000
MAX_DEPTH = 100

_DOCTYPE = re.compile(rb"\s*(?:<\?[^>]*\?>\s*|<!--(?:[^-]|-[^-])*-->\s*)*<!DOCTYPE", re.DOTALL)
_PROLOG_BYTES = 64 * 1024


def parse(xml: bytes) -> etree._Element:
    """Return the root of a BPMN file; raise `BadBpmn` if it is none or is too large."""
    if len(xml) > MAX_BYTES:
        raise _refusal(
            message(
                "bpmn.too_large",
                "a BPMN file has at most {limit} bytes, not {bytes}",
                limit=MAX_BYTES,
                bytes=len(xml),
            )
        )
    if _DOCTYPE.match(xml[:_PROLOG_BYTES].removeprefix(b"\xef\xbb\xbf")):
        raise _refusal(_doctype(), 1)
    root = _tree(xml)
    info = root.getroottree().docinfo
    if info.doctype or info.internalDTD is not None:
        raise _refusal(_doctype(), 1)
    elements = int(root.xpath("count(//*)"))
    if elements > MAX_ELEMENTS:
        raise _refusal(
            message(
                "bpmn.too_many_elements",
                "a BPMN file has at most {limit} elements, not {elements}",
                limit=MAX_ELEMENTS,
                elements=elements,
            )
        )
    if root.xpath("boolean(" + "/*" * (MAX_DEPTH + 1) + ")"):
        raise _refusal(
            message("bpmn.too_deep", "elements are nested at most {limit} deep; split it", limit=MAX_DEPTH)
        )
    if root.tag != f"{{{BPMN}}}definitions":
        raise _refusal(
            message("bpmn.wrong_root", "the root must be bpmn:definitions, not {root}", root=local(root)),
            root.sourceline,
        )
    return root


def _tree(xml: bytes) -> etree._Element:
    parser = etree.XMLParser(
        resolve_entities=False,
        no_network=True,
        huge_tree=False,
        load_dtd=False,
        dtd_validation=False,
        remove_comments=True,
        remove_pis=True,
    )
    try:
        return etree.fromstring(xml, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        raise _refusal(
            message("bpmn.not_xml", "this is not well-formed XML: {error}", error=_fault_of(error)),
            getattr(error, "lineno", None),
        ) from None


def _fault_of(error: Exception) -> str:
    """Return in plain words what the parser does not accept."""
    match getattr(error, "code", None):
        case etree.ErrorTypes.ERR_DOCUMENT_EMPTY:
            return message("bpmn.xml_empty", "it does not begin with an element; choose the BPMN file itself")
        case (
            etree.ErrorTypes.ERR_TAG_NAME_MISMATCH
            | etree.ErrorTypes.ERR_TAG_NOT_FINISHED
            | etree.ErrorTypes.ERR_DOCUMENT_END
        ):
            return message(
                "bpmn.xml_unclosed",
                "an element is not closed, or is closed under another name; export the file again",
            )
        case etree.ErrorTypes.ERR_INVALID_ENCODING | etree.ErrorTypes.ERR_INVALID_CHAR:
            return message("bpmn.xml_encoding", "it has bytes that are no text; save it as UTF-8")
        case etree.ErrorTypes.NS_ERR_UNDEFINED_NAMESPACE:
            return message("bpmn.xml_prefix", "the prefix of a name is not declared; declare it with xmlns")
        case etree.ErrorTypes.ERR_UNDECLARED_ENTITY:
            return message("bpmn.xml_entity", "an entity such as &name; is not declared; write the character")
        case _:
            return message("bpmn.xml_syntax", "it is not written as XML there; correct it or export it again")


def _refusal(text: str, line: int | None = None) -> BadBpmn:
    return BadBpmn([Fault(None, line, text)])


def _doctype() -> str:
    return message("bpmn.doctype", "a DOCTYPE is not allowed; remove it")


def local(element: etree._Element) -> str:
    """Return the name of an element without its namespace."""
    return str(etree.QName(element).localname)


def namespace(element: etree._Element) -> str:
    """Return the namespace of an element."""
    return etree.QName(element).namespace or ""


def is_bpmn(element: etree._Element) -> bool:
    """Return whether an element is one of BPMN, not of an extension."""
    return namespace(element) == BPMN


def children(element: etree._Element, *names: str) -> Iterator[etree._Element]:
    """Yield the child elements, or those of BPMN with one of `names`."""
    if not names:
        yield from element.iterchildren("{*}*")
        return
    yield from element.iterchildren(*(f"{{{BPMN}}}{name}" for name in names))


def child(element: etree._Element, name: str) -> etree._Element | None:
    """Return the first child of BPMN with this name."""
    return element.find(f"{{{BPMN}}}{name}")


def text(element: etree._Element | None) -> str:
    """Return the stripped text of an element; empty if there is none."""
    return "" if element is None else (element.text or "").strip()


def child_text(element: etree._Element, name: str) -> str:
    """Return the stripped text of the first child of BPMN with this name."""
    return text(child(element, name))


def flag(element: etree._Element, name: str, *, default: bool) -> bool:
    """Return a boolean attribute; other texts than those of XML Schema count as the default."""
    value = (element.get(name) or "").strip()
    return {"true": True, "1": True, "false": False, "0": False}.get(value, default)


def attributes_of(element: etree._Element, namespaces: Container[str | None]) -> dict[str, str]:
    """Return the attributes of an element that belong to a vendor, by their local names."""
    names = {name: etree.QName(name) for name in element.attrib}
    return {
        qualified.localname: element.attrib[name]
        for name, qualified in names.items()
        if qualified.namespace in namespaces
    }


def own_data(element: etree._Element) -> Mapping[str, str]:
    """Return the names of the data inputs and outputs of an activity or event, by id."""
    specification = child(element, "ioSpecification")
    parts = [element] if specification is None else [element, specification]
    return {
        data.get("id") or "": data.get("name") or ""
        for part in parts
        for data in children(part, "dataInput", "dataOutput")
    }


def assigned_text(association: etree._Element) -> str:
    """Return the text that a data association assigns; empty if it assigns none."""
    assignment = child(association, "assignment")
    return "" if assignment is None else child_text(assignment, "from")


def extensions(element: etree._Element) -> Iterator[etree._Element]:
    """Yield the extension elements of an element."""
    for group in children(element, "extensionElements"):
        yield from children(group)


def is_none_start(element: etree._Element) -> bool:
    """Return whether an element is a start event of a process that waits for nothing."""
    parent = element.getparent()
    if local(element) != "startEvent" or parent is None or local(parent) != "process":
        return False
    return not any(
        local(descendant).endswith(("EventDefinition", "eventDefinitionRef"))
        for descendant in element.iter("{*}*")
    )


def documentation(element: etree._Element) -> str | None:
    """Return the documentation of an element, if it has any."""
    return child_text(element, "documentation") or None
