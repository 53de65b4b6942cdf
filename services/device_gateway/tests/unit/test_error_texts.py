"""Every error of the device gateway has a code, so that pages show it in the language of the user."""

import ast
from collections.abc import Iterator

import pytest

from handover.errors import Problem
from handover.messages import Message, text_of
from handover_devices.refusals import WrongCertificate, WrongToken
from handover_devices.registry.pictures import media_type_of
from handover_devices.registry.templates import template
from handover_devices.registry.urdf import joints_in
from tests.kit.paths import REPOSITORY

GATEWAY = REPOSITORY / "services" / "device_gateway"


def details_without_code() -> Iterator[str]:
    """Yield the places where a `Problem` is made with a text that has no code."""
    for path in sorted(GATEWAY.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Problem":
                detail = node.args[2]
                if isinstance(detail, ast.Constant | ast.JoinedStr) or (
                    isinstance(detail, ast.Call) and ast.unparse(detail.func) == "str"
                ):
                    yield f"{path.relative_to(REPOSITORY)}:{node.lineno}: {ast.unparse(detail)}"


def test_no_error_has_a_text_without_a_code() -> None:
    assert list(details_without_code()) == []


def test_the_reason_why_a_file_is_refused_has_a_code_as_well() -> None:
    for urdf, code in (
        (b"<robot", "device.urdf_no_xml"),
        (b"<house/>", "device.urdf_wrong_root"),
        (b"<!DOCTYPE robot [<!ENTITY a 'b'>]><robot/>", "device.urdf_document_type"),
        (
            b"<robot><joint name='a' type='revolute'><limit lower='x'/></joint></robot>",
            "device.urdf_bad_joint",
        ),
    ):
        with pytest.raises(Problem) as refused:
            joints_in(urdf)
        body = refused.value.body()
        assert body["detailCode"] == "device.urdf_unusable"
        assert body["detailParameters"]["reason"]["textCode"] == code
    with pytest.raises(Problem) as refused:
        media_type_of(b"GIF89a")
    assert refused.value.body()["detailCode"] == "device.picture_unusable"


def test_what_does_not_exist_is_named_with_what_does() -> None:
    with pytest.raises(Problem) as missing:
        template("ur99")
    parameters = missing.value.body()["detailParameters"]
    assert parameters["template"] == "ur99"
    assert "nao" in parameters["known"]


def test_refused_credentials_have_a_code() -> None:
    for error in (WrongToken(), WrongCertificate()):
        text = text_of(error)
        assert isinstance(text, Message)
        assert text.code.startswith("device.wrong_")
