"""Service health: rates from counters."""

from handover_web.sources.services import ServiceRow, sum_counters

METRICS = """# HELP handover_broker_requests_total Requests answered
# TYPE handover_broker_requests_total counter
handover_broker_requests_total{operation="GET entities",status="200"} 40.0
handover_broker_requests_total{operation="POST entities",status="201"} 2.0
handover_broker_requests_created{operation="GET entities",status="200"} 1.7e+09
handover_broker_notifications_total{outcome="delivered"} 7.0
handover_broker_notifications_total{outcome="failed"} 3.0
nonsense
"""
COUNTERS = {
    "requests": "handover_broker_requests_total",
    "notifications": 'handover_broker_notifications_total{outcome="delivered"}',
    "absent": "handover_absent_total",
}


def test_labels_are_summed_and_missing_counters_are_zero() -> None:
    assert sum_counters(METRICS, COUNTERS) == {"requests": 42.0, "notifications": 7.0, "absent": 0.0}


def test_rates_are_computed_over_the_last_samples() -> None:
    row = ServiceRow("context-broker")
    assert row.rates() == {}
    for look in range(10):
        row.add_sample(100.0 + 2 * look, {"requests": 50.0 * look})
    assert row.rates() == {"requests": 25.0}
    assert len(row.samples) <= 5


def test_a_restarted_service_has_no_negative_rate() -> None:
    row = ServiceRow("context-broker")
    row.add_sample(0.0, {"requests": 1000.0})
    row.add_sample(2.0, {"requests": 5.0})
    assert row.rates() == {}
    row.add_sample(4.0, {"requests": 25.0})
    assert row.rates() == {"requests": 10.0}


def test_samples_in_quick_succession_give_no_rate() -> None:
    row = ServiceRow("context-broker")
    row.add_sample(0.0, {"requests": 10.0})
    row.add_sample(0.01, {"requests": 20.0})
    assert row.rates() == {}
