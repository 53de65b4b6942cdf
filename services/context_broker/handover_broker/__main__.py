"""Run the broker: `python -m handover_broker`."""

from handover.serving.server import run
from handover_broker.app import create_broker
from handover_broker.settings import BrokerSettings

if __name__ == "__main__":
    run("context-broker", create_broker, BrokerSettings, port_field="broker_port")
