"""Several brokers on one PostgreSQL."""

from pathlib import Path
from typing import Any

import psycopg

from .conftest import BrokerProcess


def settings(url: str) -> dict[str, str]:
    return {"HANDOVER_BROKER_DATABASE_URL": url}


class Brokers:
    """Brokers on one database, made and started as they are asked for."""

    def __init__(self, folder: Path, url: str) -> None:
        self.url = url
        self._all = [BrokerProcess(folder / str(number), extra=settings(url)) for number in range(3)]
        for broker in self._all:
            broker.data_dir.mkdir()

    def __getitem__(self, number: int) -> BrokerProcess:
        return self._all[number]

    def started(self, number: int) -> BrokerProcess:
        """Return one of the brokers, started."""
        broker = self._all[number]
        return broker if broker.process else broker.start()

    def leader(self) -> Any:
        """Return the broker that leads now, None while none does."""
        alive = (broker for broker in self._all if broker.process)
        return next((one for one in alive if one.metric("handover_broker_leads") == 1), None)

    def asked(self, query: str) -> list[tuple[Any, ...]]:
        """Return what the database says."""
        with psycopg.connect(
            self.url, autocommit=True, options="-c search_path=context_broker"
        ) as connection:
            return connection.execute(query).fetchall()

    def stop(self) -> None:
        for broker in self._all:
            broker.stop()
