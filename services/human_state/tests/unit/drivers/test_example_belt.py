"""The example of a driver in a package of others keeps the contract."""

import importlib.util
import sys
from types import ModuleType

from tests.kit.paths import REPOSITORY

EXAMPLE = REPOSITORY / "examples" / "tcp_belt"


def _loaded(name: str, path: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLE / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


_loaded("tcp_belt", "tcp_belt.py")
_tests = _loaded("test_tcp_belt", "tests/test_tcp_belt.py")
TestBelt = _tests.TestBelt
test_any_line_is_a_finite_number_or_refused = _tests.test_any_line_is_a_finite_number_or_refused
