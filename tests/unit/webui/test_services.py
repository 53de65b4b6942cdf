"""Services: what their counters say, as so much a second."""

from webui.sources.services import Row, summed

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


def test_labels_are_added_up_and_what_is_not_counted_is_zero() -> None:
    assert summed(METRICS, COUNTERS) == {"requests": 42.0, "notifications": 7.0, "absent": 0.0}


def test_a_rate_is_the_difference_over_the_last_looks() -> None:
    row = Row("context-broker")
    assert row.rates() == {}
    for look in range(10):
        row.counted(100.0 + 2 * look, {"requests": 50.0 * look})
    assert row.rates() == {"requests": 25.0}
    assert len(row.counts) <= 5


def test_a_service_that_was_started_anew_has_no_negative_rate() -> None:
    row = Row("context-broker")
    row.counted(0.0, {"requests": 1000.0})
    row.counted(2.0, {"requests": 5.0})
    assert row.rates() == {}
    row.counted(4.0, {"requests": 25.0})
    assert row.rates() == {"requests": 10.0}


def test_a_look_out_of_turn_makes_no_rate() -> None:
    row = Row("context-broker")
    row.counted(0.0, {"requests": 10.0})
    row.counted(0.01, {"requests": 20.0})
    assert row.rates() == {}
