"""The Prometheus metrics of the web UI server."""

from prometheus_client import Counter, Gauge

PAGES = Gauge("handover_webui_open_pages", "Pages that are open")
BATCHES = Counter("handover_webui_batches_sent_total", "Batches sent to pages")
COALESCED = Counter(
    "handover_webui_coalesced_values_total", "Values replaced by newer ones before they were sent to a page"
)
SLOW_PAGES = Counter(
    "handover_webui_slow_pages_disconnected_total", "Pages disconnected because they did not read"
)
EVENTS = Counter("handover_webui_events_total", "Events recorded in the event log", ["key"])
UPSTREAM_ERRORS = Counter(
    "handover_webui_upstream_errors_total", "Proxied requests that the service did not answer", ["service"]
)
ACTIVE_REQUESTS = Gauge(
    "handover_webui_proxied_requests_active", "Requests that are being proxied to services"
)
REJECTED_REQUESTS = Counter(
    "handover_webui_proxied_requests_rejected_total", "Requests rejected because of a limit", ["limit"]
)
EVICTED_REQUESTS = Counter(
    "handover_webui_proxied_requests_evicted_total", "Requests ended early to admit newer ones"
)
BROKER_ABILITIES = Gauge(
    "handover_broker_ability",
    "Whether another broker can do something (1) or not (0)",
    ["ability"],
)
