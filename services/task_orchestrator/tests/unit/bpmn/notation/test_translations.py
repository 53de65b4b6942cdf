"""Translations: the texts of a file in other languages, and what is reported of them."""

from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_bpmn.model import Definition
from handover_bpmn.notation.dialects import translations
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import read_bpmn

SHIPPED = sorted(Path("services").glob("**/*.bpmn"))
TEXTS = st.text(st.characters(exclude_categories=["C"]), min_size=1, max_size=50).filter(str.strip)
FORM = '{"type": "object", "properties": {"mass": {"type": "number", "title": "Mass of the part"}}}'


def read(*groups: str, name: str = "Take the part") -> Definition:
    """Return the definition of a file with these `handover:translations`."""
    xml = f"""<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL"
        xmlns:handover="urn:handover:bpmn" targetNamespace="t">
      <bpmn:process id="p" name="Parts" isExecutable="true">
        <bpmn:extensionElements>{"".join(groups)}</bpmn:extensionElements>
        <bpmn:startEvent id="s"/>
        <bpmn:userTask id="take" name={quoteattr(name)}>
          <bpmn:documentation>From the bin</bpmn:documentation>
          <bpmn:extensionElements><handover:task definition="take">
            <handover:parameter name="description" value="Take it by hand"/>
            <handover:form>{FORM}</handover:form>
          </handover:task></bpmn:extensionElements>
        </bpmn:userTask>
        <bpmn:endEvent id="e"/>
        <bpmn:sequenceFlow id="a" sourceRef="s" targetRef="take"/>
        <bpmn:sequenceFlow id="b" sourceRef="take" targetRef="e"/>
      </bpmn:process>
    </bpmn:definitions>"""
    (definition,) = read_bpmn(xml.encode()).definitions
    return definition


def group(language: str, *pairs: tuple[str, str]) -> str:
    """Return a `handover:translations`."""
    entries = "".join(
        f"<handover:translation source={quoteattr(source)}>{escape(text)}</handover:translation>"
        for source, text in pairs
    )
    return f'<handover:translations language="{language}">{entries}</handover:translations>'


def test_every_kind_of_text_can_be_translated() -> None:
    pairs = (
        ("Parts", "Teile"),
        ("Take the part", "Nehmen Sie das Teil"),
        ("From the bin", "Aus der Kiste"),
        ("Take it by hand", "Mit der Hand"),
        ("Mass of the part", "Masse des Teils"),
    )
    definition = read(group("de", *pairs), group("pt-BR", ("Parts", "Peças")))
    assert definition.translations == {"de": dict(pairs), "pt-BR": {"Parts": "Peças"}}
    assert definition.warnings == ()


@pytest.mark.parametrize(
    ("groups", "said"),
    [
        ([group("German", ("Parts", "Teile"))], 'language="German" is no language'),
        ([group("", ("Parts", "Teile"))], 'language="" is no language'),
        ([group("de", ("Parts", " "))], "handover:translation has a text of the file as its source"),
        ([group("de", ("", "Teile"))], "handover:translation has a text of the file as its source"),
        ([group("de", ("Parts", "Teile")), group("de", ("Parts", "Stücke"))], '"Parts" has two translations'),
        ([group("de", ("Parts", "x" * 2001))], "at most 2000 characters"),
        (
            ['<handover:translations language="de"><handover:text/></handover:translations>'],
            "text is unknown here",
        ),
        (['<handover:translations lang="de"/>'], 'has no attribute "lang"'),
    ],
)
def test_what_cannot_be_a_translation_is_refused(groups: list[str], said: str) -> None:
    with pytest.raises(BadBpmn) as refused:
        read(*groups)
    assert said in " ".join(map(str, refused.value.faults))


def test_a_placeholder_that_the_source_does_not_have_is_a_warning() -> None:
    pairs = (("Take ${part} of ${order}", "Nehmen Sie ${teil}"),)
    definition = read(group("de", *pairs), name="Take ${part} of ${order}")
    (warning,) = definition.warnings
    assert "has ${teil}, which the text does not have" in str(warning)
    assert definition.translations == {"de": dict(pairs)}


def test_a_source_that_the_file_does_not_have_is_a_warning() -> None:
    definition = read(group("de", ("Take the prat", "Nehmen Sie das Teil")))
    (warning,) = definition.warnings
    assert str(warning).endswith(
        '"Take the prat" is no text of this file; its translation is shown only if a deployed form has it'
    )


def test_too_many_translations_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(translations, "MAX_TRANSLATIONS", 2)
    with pytest.raises(BadBpmn, match="at most 2 translations"):
        read(*(group(language, ("Parts", "x")) for language in ("de", "fi", "fr")))


@given(
    st.text(st.characters(exclude_categories=["C"]), min_size=1, max_size=50).filter(
        lambda text: text.strip()
    ),
    st.text(st.characters(exclude_categories=["C"]), min_size=1, max_size=50).filter(
        lambda text: text.strip()
    ),
)
def test_any_text_can_be_translated(source: str, translation: str) -> None:
    definition = read(group("de", (source, translation)), name=source)
    plain = " ".join(source.split())
    assert definition.translations == {"de": {plain: " ".join(translation.split())}}
    assert not definition.warnings


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_processes_are_translated(path: Path) -> None:
    """Every drawn name and every description of a shipped process has a German and a Finnish text."""
    for definition in read_bpmn(path.read_bytes()).definitions:
        read_texts = {definition.title}
        for node in definition.nodes():
            activity = node.activity
            read_texts |= {node.name} if node.name != node.id else set()
            if activity is not None:
                description = activity.parameters.get("description")
                read_texts |= {activity.description or "", description.literal if description else ""}
        for language in ("de", "fi"):
            assert read_texts - {""} <= definition.translations[language].keys(), language
        assert definition.warnings == ()
