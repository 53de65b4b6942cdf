import doctest

import handover_bpmn


def test_the_example_of_the_package_runs_without_a_service() -> None:
    results = doctest.testmod(handover_bpmn)
    assert results.attempted > 0
    assert results.failed == 0
