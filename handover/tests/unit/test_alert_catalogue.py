"""The catalogue of Alerts: unique, used, known to the page, and documented."""

import ast
import re
import string

from handover.alerts import catalogue as alert_catalogue
from handover.alerts.catalogue import CATALOGUE, AlertCategory, AlertType, as_markdown
from handover_web.messages import python_sources
from tests.kit.paths import REPOSITORY


def test_every_alert_has_its_own_subcategory_and_a_known_category() -> None:
    sub_categories = [one.sub_category for one in CATALOGUE]
    assert len(set(sub_categories)) == len(sub_categories)
    assert {one.category for one in CATALOGUE} <= set(AlertCategory)


def test_the_reference_shows_the_catalogue() -> None:
    page = (REPOSITORY / "docs" / "reference" / "alerts.md").read_text()
    assert as_markdown() in page


def test_every_alert_is_raised_by_a_service_or_by_the_server_of_all() -> None:
    sources = [
        file.read_text()
        for folder in ("services", "ros_fiware_bridge")
        for file in python_sources(REPOSITORY / folder)
    ]
    sources += [
        (REPOSITORY / "handover/handover" / f"{name}.py").read_text()
        for name in (
            "serving/certificate_watch",
            "subscriptions/own_subscriptions",
            "alerts/reporting_writer",
            "serving/watchdog",
        )
    ]
    named = {name: one for name, one in vars(alert_catalogue).items() if isinstance(one, AlertType)}
    assert set(named.values()) == set(CATALOGUE)
    for name in named:
        assert any(re.search(rf"\b{name}\b", source) for source in sources), name


def test_services_give_what_a_description_needs() -> None:
    """The texts are in the catalogue; a service names the kind, the code and the parameters."""
    described = set()
    for folder in ("handover", "services", "ros_fiware_bridge"):
        for file in python_sources(REPOSITORY / folder):
            source = file.read_text()
            for call in ast.walk(ast.parse(source)) if ".describe(" in source else ():
                match call:
                    case ast.Call(
                        func=ast.Attribute(
                            value=ast.Name(id=name) | ast.Attribute(attr=name), attr="describe"
                        ),
                        args=[ast.Constant(value=str(code))],
                        keywords=parameters,
                    ) if name in vars(alert_catalogue):
                        template = vars(alert_catalogue)[name].descriptions[code]
                        needed = {part[1] for part in string.Formatter().parse(template) if part[1]}
                        assert needed == {parameter.arg for parameter in parameters}, (file, code)
                        described.add(code)
    assert described == {code for alert_type in CATALOGUE for code in alert_type.descriptions}


def test_no_service_writes_a_category_of_its_own() -> None:
    for folder in ("services", "ros_fiware_bridge", "webui"):
        for file in python_sources(REPOSITORY / folder):
            assert not re.search(r'\bAlertType\(\s*"', file.read_text()), file


def test_the_page_explains_only_alerts_of_the_catalogue() -> None:
    source = (REPOSITORY / "webui" / "app" / "src" / "alerts" / "attention.ts").read_text()
    known = re.search(r"knownKinds = new Set\(\[(.*?)\]\)", source)
    assert known is not None
    assert set(re.findall(r'"(\w+)"', known.group(1))) <= {one.sub_category for one in CATALOGUE}
