"""Run the broker: `python -m services.context_broker`."""

from handover.serving import run
from services.context_broker.app import create_broker
from services.context_broker.settings import BrokerSettings

if __name__ == "__main__":
    run("context-broker", create_broker, BrokerSettings, port_field="broker_port")
