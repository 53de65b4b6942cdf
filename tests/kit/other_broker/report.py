"""The report of a run with another broker: what the broker can do, and which tests failed for that.

`needs.toml` lists the tests that need an ability which a broker may lack. Where it is lacking such a test is
expected to fail: it is run and reported, and does not fail the run.
"""

import json
import os
import secrets
import tomllib
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any, Final

import pytest

from tests.kit.other_broker import running
from tests.kit.other_broker.abilities import abilities
from tests.kit.other_broker.profiles import RULES, profile_of

NEEDS: Final = Path(__file__).with_name("needs.toml")
ABILITIES: Final = "HANDOVER_TEST_BROKER_ABILITIES"
"""The variable with which the workers of a run get the abilities of the broker."""
STATES: Final[Mapping[bool | None, str]] = {True: "there", False: "not there", None: "not tried"}


def needs() -> dict[str, dict[str, str]]:
    """Return the tests that need each ability, with the reason."""
    return tomllib.loads(NEEDS.read_text(encoding="utf-8"))


def found_abilities() -> dict[str, bool | None]:
    """Return the abilities of the broker of this run: found once, by the process that starts the workers."""
    if ABILITIES not in os.environ:
        rules = profile_of(running.PROFILE).rules
        found = (
            abilities(running.URL, tenant=f"probe_{secrets.token_hex(6)}")
            if running.URL
            else {name: name not in rules for name in RULES}
        )
        os.environ[ABILITIES] = json.dumps(found)
    known: dict[str, bool | None] = json.loads(os.environ[ABILITIES])
    return known


class BrokerReport:
    """A plugin of pytest."""

    def __init__(self) -> None:
        self.abilities = found_abilities()
        self._needs = {
            test: (ability, reason)
            for ability, tests in needs().items()
            if not self.abilities[ability]
            for test, reason in tests.items()
        }

    def lacking(self, test: str) -> str | None:
        """Return what a test needs that the broker lacks; `test` is its id, with or without parameters."""
        ability, reason = self._needs.get(test) or self._needs.get(test.partition("[")[0]) or ("", "")
        return f"needs {ability}: {reason}" if ability else None

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, Any, Any]:
        """Report the failure of a test that needs what the broker lacks as expected."""
        report = yield
        lacking = self.lacking(item.nodeid)
        if lacking and (report.failed or (report.passed and report.when == "call")):
            report.wasxfail = lacking
            report.outcome = "skipped" if report.failed else "passed"
        return report

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Print the table of abilities and the tests that failed."""
        say = terminalreporter.write_line
        terminalreporter.section(f"broker: {running.BROKER}")
        for name, is_there in self.abilities.items():
            say(f"{STATES[is_there]:10} {name:22} {RULES[name].ability}")
        for title, kind in (
            ("failed, as the broker lacks what they need", "xfailed"),
            ("passed, although the list says that they need what the broker lacks", "xpassed"),
            ("failed", "failed"),
            ("failed before they began, or at their end", "error"),
        ):
            reports = terminalreporter.stats.get(kind, [])
            say(f"\n{title}: {len(reports)}")
            for report in reports:
                say(f"  {report.nodeid}  {getattr(report, 'wasxfail', '')}".rstrip())
