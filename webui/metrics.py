"""Metrics: what the screen's server counts for Prometheus."""

from prometheus_client import Counter, Gauge

PAGES = Gauge("handover_webui_pages", "Pages that are open")
BATCHES = Counter("handover_webui_batches_total", "Batches sent to pages")
COALESCED = Counter(
    "handover_webui_coalesced_total", "Values that were overtaken by newer ones before a page had read them"
)
TOO_SLOW = Counter("handover_webui_slow_pages_total", "Pages that were let go because they did not read")
EVENTS = Counter("handover_webui_events_total", "Events taken into the log", ["key"])
AWAY = Counter("handover_webui_service_away_total", "Requests to a service that did not answer", ["service"])
STREAMS = Gauge("handover_webui_streams", "Requests to services that are being passed on")
REFUSED = Counter("handover_webui_streams_refused_total", "Requests that were one too many", ["limit"])
ENDED = Counter("handover_webui_streams_ended_total", "Requests that were ended for the sake of others")
