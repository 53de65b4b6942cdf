"""The list of tests that need what a broker may lack."""

import ast

import pytest

from tests.kit.other_broker.profiles import ORION_LD, PLAIN, RULES, profile_of
from tests.kit.other_broker.report import needs
from tests.kit.paths import REPOSITORY


def test_each_entry_names_an_ability_a_test_and_a_reason() -> None:
    for ability, tests in needs().items():
        assert ability in RULES
        for test, reason in tests.items():
            file, *_, name = test.partition("[")[0].split("::")
            tree = ast.parse((REPOSITORY / file).read_text(encoding="utf-8"))
            functions = (ast.FunctionDef, ast.AsyncFunctionDef)
            assert name in {node.name for node in ast.walk(tree) if isinstance(node, functions)}, test
            assert reason, test


def test_a_profile_is_named_with_the_rules_that_it_leaves_out() -> None:
    assert profile_of("orion-ld-1.6.0 -history").rules == ORION_LD.rules - {"history"}
    assert profile_of("plain") == PLAIN
    with pytest.raises(KeyError):
        profile_of("orion-ld-1.7.0")


def test_a_rule_that_does_not_exist_cannot_be_left_out() -> None:
    with pytest.raises(ValueError, match=r"no rule.*past"):
        profile_of("orion-ld-1.6.0 -past")
