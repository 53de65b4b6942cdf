"""The generated TypeScript types of the messages between server and page."""

from typing import Annotated, Literal

import pytest
from pydantic import Field
from typing_extensions import TypedDict

from handover_web import types
from handover_web.live import views


def test_the_types_of_the_page_match_the_views() -> None:
    assert types.FILE.read_text(encoding="utf-8") == types.typescript(), "run python -m handover_web.types"


class Lamp(TypedDict):
    """A lamp."""

    name: str
    watts: float | None
    state: Literal["on", "off"]
    tags: list[str | int]
    timers: dict[str, list[float]]


def test_typed_dictionaries_become_interfaces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(views, "VIEWS", (Lamp,))
    monkeypatch.setattr(views, "ALIASES", {"LampState": Literal["on", "off"]})
    monkeypatch.setattr(views, "TOPICS", {"lamps": list[Lamp], "lamp/": Lamp})
    monkeypatch.setattr(views, "ORCHESTRATOR_TOPICS", {"process/": "ProcessView"})
    text = types.typescript()
    assert 'export type LampState = "on" | "off";' in text
    assert (
        "/** A lamp. */\n"
        "export interface Lamp {\n"
        "  name: string;\n"
        "  watts: number | null;\n"
        "  state: LampState;\n"
        "  tags: (string | number)[];\n"
        "  timers: Record<string, number[]>;\n"
        "}\n"
    ) in text
    assert "  lamps: Lamp[];\n  [lamp: `lamp/${string}`]: Lamp;\n" in text
    assert 'import type { ProcessView } from "~/api/generated/task-orchestrator";' in text
    assert "  [process: `process/${string}`]: ProcessView;\n" in text


def test_pairs_become_tuples_and_limits_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    fields = {"pair": tuple[int, str], "level": Annotated[int, Field(ge=0, le=9)]}
    monkeypatch.setattr(views, "VIEWS", (TypedDict("Meter", fields),))  # type: ignore[operator]
    monkeypatch.setattr(views, "TOPICS", {})
    text = types.typescript()
    assert "export interface Meter {\n  pair: [number, string];\n  level: number;\n}\n" in text


def test_unsupported_schemas_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    either = Annotated[str, Field(json_schema_extra={"not": {}})]
    bad = TypedDict("bad", {"either": either})  # type: ignore[valid-type]  # noqa: UP013
    monkeypatch.setattr(views, "VIEWS", (bad,))
    with pytest.raises(types.InvalidSchema, match="not supported"):
        types.typescript()


@pytest.mark.parametrize(
    ("topic", "view"),
    [("glove/glove-1", views.GloveView), ("robot/ur10-1/joints", views.JointState), ("cell", views.CellView)],
)
def test_every_topic_has_a_type(topic: str, view: type) -> None:
    assert views.type_of_topic(topic) is view
