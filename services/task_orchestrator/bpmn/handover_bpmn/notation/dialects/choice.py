"""Choice: the dialects that a file uses. A new dialect is a module and a line in `_DIALECTS`."""

from collections.abc import Callable

from lxml import etree

from handover_bpmn.notation.dialects import (
    camunda7,
    camunda7_elements,
    handover,
    handover_elements,
    jbpm,
    zeebe,
)
from handover_bpmn.notation.dialects.base import Dialect
from handover_bpmn.notation.document import children, extensions, local, namespace
from handover_bpmn.notation.elements import warn_unknown_extension
from handover_bpmn.notation.faults import Findings

_DIALECTS: tuple[tuple[tuple[str, ...], str, Callable[[], Dialect]], ...] = (
    ((zeebe.NAMESPACE,), "Camunda Cloud", zeebe.Zeebe),
    (camunda7_elements.NAMESPACES, "Camunda Platform", camunda7.Camunda7),
    (jbpm.NAMESPACES, "jBPM", jbpm.Jbpm),
)
"""The namespaces of each dialect beside ours, and the platform that Camunda Modeler names.

The first one that a file uses has its expression language.
"""

_LANGUAGES = ("expressionLanguage", "typeLanguage")
_LANGUAGES_OF_JBPM = ("http://www.mvel.org", "http://www.java.com")
"""The languages that jBPM declares for a file, also if it uses none of its extensions."""

_EXECUTABLE_BY_DEFAULT = ("http://activiti.org/bpmn", "http://flowable.org/bpmn")

_PLATFORM = "{http://camunda.org/schema/modeler/1.0}executionPlatform"
_KNOWN = frozenset(
    {handover_elements.NAMESPACE, *(name for namespaces, _, _ in _DIALECTS for name in namespaces)}
)


class Dialects:
    """The dialects of a file: `main` has the expression language; ours may be used beside it."""

    def __init__(self, root: etree._Element) -> None:
        used = _used_namespaces(root)
        declared = self._declared = used.union(root.nsmap.values())
        self.is_ours = handover_elements.NAMESPACE in declared
        """Whether the file was drawn for us: what cannot be read in our language is then a fault."""
        self.handover = handover.Handover(is_strict=self.is_ours)
        self.main: Dialect = self.handover
        platform = root.get(_PLATFORM)
        for namespaces, name, dialect in _DIALECTS:
            if platform == name or (platform is None and used.intersection(namespaces)):
                self.main = dialect()
                return
        if not self.is_ours:
            self.main = _declared(root, declared) or self.handover

    @property
    def runs_undeclared(self) -> bool:
        """Whether processes run that do not say whether they are executable."""
        return isinstance(self.main, jbpm.Jbpm) or not self._declared.isdisjoint(_EXECUTABLE_BY_DEFAULT)

    def of(self, element: etree._Element) -> Dialect:
        """Return the dialect of an event: ours if it has our extension elements."""
        parts = [part for part in children(element) if local(part).endswith("EventDefinition")]
        ours = any(
            namespace(extension) == handover_elements.NAMESPACE
            for part in (element, *parts)
            for extension in extensions(part)
        )
        return self.handover if ours else self.main

    def check(self, element: etree._Element, findings: Findings) -> None:
        """Report extension elements and attributes without effect, of unknown vendors too."""
        self.handover.check(element, findings)
        if self.main is not self.handover:
            self.main.check(element, findings)
        for extension in extensions(element):
            if namespace(extension) not in _KNOWN:
                warn_unknown_extension(extension, findings)


def _declared(root: etree._Element, namespaces: set[str | None]) -> Dialect | None:
    """Return the dialect of a file that declares a vendor without using any extension of it."""
    languages = [root.get(name) or "" for name in _LANGUAGES]
    if any(language.startswith(_LANGUAGES_OF_JBPM) for language in languages):
        return jbpm.Jbpm()
    dialects = [
        dialect for own, _, dialect in _DIALECTS if dialect is not jbpm.Jbpm and namespaces.intersection(own)
    ]
    return dialects[0]() if len(dialects) == 1 else None


def _used_namespaces(root: etree._Element) -> set[str | None]:
    """Return the namespaces of all elements and attributes of a file."""
    names: set[str | None] = set()
    for element in root.iter("{*}*"):
        names.add(namespace(element))
        for name in element.attrib:
            if name[0] == "{":
                names.add(name[1:].partition("}")[0])
    return names
