"""The XML of a file: hostile, huge and broken files are refused at once, with a reason."""

from pathlib import Path

import pytest

from handover_bpmn.notation.document import MAX_BYTES, MAX_ELEMENTS
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import read_bpmn
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, drawing, start


@pytest.mark.parametrize(
    ("xml", "reason"),
    [
        (b"", "not well-formed"),
        (b"this is no XML", "not well-formed"),
        (b"\xff\xfe\x00", "not well-formed"),
        (b"<a b='\xff'/>", "no text; save it as UTF-8"),
        (b"<a:b/>", "not declared; declare it with xmlns"),
        (b"<a>&nbsp;</a>", "is not declared; write the character"),
        (b"<a/>", "the root must be bpmn:definitions"),
        (drawing(ONE_STEP)[:-20], "not well-formed"),
        (b"<a><b></a>", "an element is not closed, or is closed under another name"),
        (b" " * (MAX_BYTES + 1), f"at most {MAX_BYTES} bytes"),
        (b" " * 50_000_000, f"at most {MAX_BYTES} bytes"),
        (drawing("<bpmn:task/>" * 100_000), f"at most {MAX_ELEMENTS} elements, not 100002"),
        (drawing("<bpmn:subProcess>" * 150 + "</bpmn:subProcess>" * 150), "nested at most 100 deep"),
        (drawing("<bpmn:subProcess>" * 9000 + "</bpmn:subProcess>" * 9000), "not well-formed"),
    ],
    ids=range(14),
)
def test_a_file_that_is_no_bpmn_is_refused(xml: bytes, reason: str) -> None:
    with pytest.raises(BadBpmn, match=reason):
        read_bpmn(xml)


@pytest.mark.parametrize("place", ["text", "attribute"])
@pytest.mark.parametrize("prolog", ["", '<?xml version="1.0"?>\n<!-- - -->', "\ufeff"])
def test_an_xml_bomb_is_refused(place: str, prolog: str) -> None:
    laughs = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
    body = start() + "&l9;" if place == "text" else '<bpmn:startEvent id="s" name="&l9;"/>'
    bomb = f'{prolog}<!DOCTYPE bomb [<!ENTITY l0 "ha">{laughs}]>'.encode() + drawing(body)
    with pytest.raises(BadBpmn, match="a DOCTYPE is not allowed"):
        read_bpmn(bomb)


def test_a_bomb_in_utf_16_is_refused_too() -> None:
    laughs = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
    body = '<bpmn:startEvent id="s" name="&l9;"/>'
    bomb = f'<!DOCTYPE bomb [<!ENTITY l0 "ha">{laughs}]>' + drawing(body).decode()
    with pytest.raises(BadBpmn):
        read_bpmn(bomb.encode("utf-16"))


def test_an_external_entity_is_never_read(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("the secret")
    doctype = f'<!DOCTYPE x [<!ENTITY secret SYSTEM "file://{secret}">]>'
    for encoding in ("utf-8", "utf-16"):
        with pytest.raises(BadBpmn, match="DOCTYPE") as bad:
            read_bpmn((doctype + drawing(start() + "&secret;").decode()).encode(encoding))
        assert "the secret" not in str(bad.value.body())


def test_the_word_doctype_in_a_text_is_harmless() -> None:
    body = "<bpmn:documentation>&lt;!DOCTYPE html&gt;</bpmn:documentation>" + ONE_STEP
    assert read_bpmn(drawing(body)).definitions[0].description == "<!DOCTYPE html>"
