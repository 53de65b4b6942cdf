"""Which elements two BPMN files have in different form."""

from handover_bpmn.notation.comparison import changed_elements
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start


def changes(before: str, after: str) -> set[tuple[str, str]]:
    found = changed_elements(drawing(before), drawing(after), "p")
    return {(each.element, each.change) for each in found}


def test_elements_that_were_added_removed_or_changed_are_listed() -> None:
    before = start() + activity("a") + activity("b") + end() + path("start", "a", "b", "end")
    after = start() + activity("a", attributes='deadline="PT1M"') + activity("c") + end()
    assert changes(before, after) == {("a", "changed"), ("b", "removed"), ("c", "added")}


def test_flows_layout_and_the_order_of_attributes_do_not_count() -> None:
    before = start() + '<bpmn:userTask id="a" name="A"/>' + end() + path("start", "a", "end")
    after = (
        '<bpmn:userTask name="A" id="a">\n  <bpmn:incoming>x</bpmn:incoming>\n</bpmn:userTask>'
        + end()
        + start()
    )
    assert changes(before, after) == set()


def test_elements_within_a_subprocess_are_compared() -> None:
    def within(inner: str) -> str:
        return f'<bpmn:subProcess id="sub" name="Sub">{inner}</bpmn:subProcess>'

    assert changes(within(activity("a")), within(activity("b"))) == {("a", "removed"), ("b", "added")}
    assert changes(within(activity("a")), within(activity("a")).replace("Sub", "Other", 1)) == {
        ("sub", "changed")
    }
