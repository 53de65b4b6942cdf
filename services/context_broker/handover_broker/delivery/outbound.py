"""What the notifiers of all tenants share to deliver notifications over HTTP or MQTT."""

from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass, field
from weakref import WeakValueDictionary

from handover.network.http_client import PooledHttpClient
from handover.network.outbound_policy import OutboundPolicy
from handover_broker.delivery.endpoint import Endpoint
from handover_broker.delivery.endpoint_queue import WAITING, EndpointQueue, EndpointUser, MemoryBudget
from handover_broker.delivery.mqtt_sender import MqttSender
from handover_broker.delivery.notification import headers, mqtt_message
from handover_broker.delivery.subscription import Subscription
from handover_broker.storage.journal import Journal


@dataclass(frozen=True, slots=True)
class Outbound:
    """The outbox, the senders, and the queues of all endpoints.

    `timeout_s` is the default timeout of a notification, `keep_s` how long it is retried, `keep_bytes` the
    limit of pending bytes of one endpoint.
    """

    journal: Journal
    sender: PooledHttpClient
    mqtt: MqttSender
    policy: OutboundPolicy
    _: KW_ONLY
    timeout_s: float
    keep_s: float
    keep_bytes: int
    memory_budget: MemoryBudget = field(default_factory=MemoryBudget)
    endpoint_queues: "WeakValueDictionary[tuple[object, ...], EndpointQueue]" = field(
        default_factory=WeakValueDictionary
    )

    def __post_init__(self) -> None:
        WAITING.labels("memory").set_function(lambda: sum(worker.held for worker in self._waiting()))
        WAITING.labels("disk").set_function(lambda: sum(worker.on_disk for worker in self._waiting()))
        WAITING.labels("throttled").set_function(lambda: sum(worker.throttled for worker in self._waiting()))

    def _waiting(self) -> Iterator[EndpointUser]:
        for endpoint_queue in list(self.endpoint_queues.values()):
            yield from list(endpoint_queue.workers)

    def endpoint_queue(self, endpoint: Endpoint) -> EndpointQueue:
        """Return the queue of an endpoint; it exists while a delivery worker uses it."""
        endpoint_queue = self.endpoint_queues.get(endpoint.key)
        if endpoint_queue is None:
            endpoint_queue = self.endpoint_queues[endpoint.key] = EndpointQueue(
                self.memory_budget, self.keep_bytes
            )
        return endpoint_queue

    async def post(self, subscription: Subscription, tenant: str, body: bytes, taken: bytes | None) -> int:
        """Send a notification; return the status of the response, or raise `SendError` if there is none.

        `taken` are headers of the request that made the change, as JSON. MQTT has no status: an acknowledged
        message counts as 204.
        """
        endpoint = subscription.endpoint
        timeout_s = endpoint.timeout_s or self.timeout_s
        if endpoint.mqtt is not None:
            await self.mqtt.publish(endpoint.mqtt, mqtt_message(subscription, tenant, body, taken), timeout_s)
            return 204
        return await self.sender.post(endpoint.uri, headers(subscription, tenant, taken), body, timeout_s)

    async def close(self) -> None:
        """Close all connections."""
        self.sender.close()
        await self.mqtt.close()
