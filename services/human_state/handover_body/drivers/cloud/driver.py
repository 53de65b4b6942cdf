"""Devices whose data are with their vendor: polled with OAuth 2, values with their times.

A vendor is a subclass that names its URL and reads its answer; `vivalink` is the example. Values are as
late as the vendor makes them: their times are kept, so stale ones are stale. Nothing is sent but requests,
and only to addresses that the outbound policy allows.
"""

import asyncio
from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Final
from urllib.parse import urlsplit

import numpy as np
from pydantic import Field, SecretStr, field_validator

from handover.network.http_client import BodyReadingHttpClient, Resolver, SendError
from handover.settings import Settings
from handover_body.drivers.base import DriverSettings, LinkLost, PacketError, SensorDriver, Sink, now_s
from handover_body.drivers.cloud.oauth import MAX_ANSWER_BYTES, AccessDenied, Credentials, OAuthClient
from handover_body.model.signals import ClockKind, LinkState, Samples, SensorReport, SignalInfo

MAX_VALUES: Final = 100_000
"""Values of one answer that are passed on; a longer history is no live signal."""


@dataclass(frozen=True, slots=True)
class CloudValue:
    """One value: when it was measured, in s since 1970, and of which signal of the driver."""

    info: SignalInfo
    at_s: float
    value: float
    quality: float = 1.0


class CloudSettings(DriverSettings):
    """Where the vendor is, and who we are there."""

    base_url: str
    token_url: str
    client_id: str
    client_secret: SecretStr
    refresh_token: SecretStr = SecretStr("")
    scope: str = ""
    device_id: str
    poll_s: float = Field(10.0, ge=0.02, le=3600)
    history_s: float = Field(60.0, gt=0, le=86_400)
    """Older values are not asked for."""

    @field_validator("base_url", "token_url")
    @classmethod
    def _is_https(cls, value: str) -> str:
        parts = urlsplit(value)
        is_here = parts.hostname in {"127.0.0.1", "::1", "localhost"}
        if parts.scheme != "https" and not (parts.scheme == "http" and is_here):
            raise ValueError(f"{value} is not encrypted; data of a person need an https:// address")
        return value.rstrip("/")


class CloudDriver(SensorDriver):
    """A device of one person at a vendor."""

    settings_model: ClassVar[type[DriverSettings]] = CloudSettings
    max_latency_s = 60.0
    max_silence_s = 86_400.0  # a vendor without new values is no lost link; the values grow stale

    def __init__(self, source: str, settings: CloudSettings, resolver: Resolver | None = None) -> None:
        super().__init__(source, settings)
        self._resolver = resolver or Settings.load().outbound_policy()
        self._newest_s: dict[SignalInfo, float] = {}

    @abstractmethod
    def url(self, since_s: float) -> str:
        """Return what to ask for values measured after `since_s`."""

    @abstractmethod
    def read(self, content: Any) -> Iterable[CloudValue]:
        """Return the values in an answer; raise `PacketError`, `KeyError`, `TypeError` or `ValueError`."""

    async def run(self, sink: Sink) -> None:
        settings: CloudSettings = self.settings
        http = BodyReadingHttpClient(self._resolver, max_response_bytes=MAX_ANSWER_BYTES)
        credentials = Credentials(
            settings.token_url,
            settings.client_id,
            settings.client_secret.get_secret_value(),
            settings.scope,
            settings.refresh_token.get_secret_value(),
        )
        client = OAuthClient(http, credentials)
        is_connected = False
        try:
            while True:
                since_s = max(min(self._newest_s.values(), default=0.0), now_s() - settings.history_s)
                content = await client.get(settings.base_url + self.url(since_s), now_s())
                if not is_connected:
                    is_connected = True
                    sink(SensorReport(self.source, now_s(), link=LinkState.CONNECTED))
                try:
                    self._pass_on(self._checked(content), sink)
                except PacketError as error:
                    self.reject(sink, error)
                await asyncio.sleep(settings.poll_s)
        except AccessDenied as denied:
            raise LinkLost(f"{urlsplit(settings.base_url).hostname}: {denied}") from denied
        except (SendError, PacketError) as error:
            raise LinkLost(f"{urlsplit(settings.base_url).hostname} is not reached: {error}") from error
        finally:
            http.close()

    def _checked(self, content: Any) -> list[CloudValue]:
        try:
            values = list(self.read(content))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise PacketError(f"the answer is not as documented ({type(error).__name__}: {error})") from error
        if len(values) > MAX_VALUES:
            raise PacketError(f"{len(values)} values in one answer; at most {MAX_VALUES} are read")
        return values

    def _pass_on(self, values: list[CloudValue], sink: Sink) -> None:
        latest_s = now_s() + 5.0
        for info in self.signals:
            newest_s = self._newest_s.get(info, -np.inf)
            mine = sorted(
                {
                    reading.at_s: reading
                    for reading in values
                    if reading.info is info and newest_s < reading.at_s <= latest_s
                }.items()
            )
            if not mine:
                continue
            times_s = np.array([at_s for at_s, _ in mine])
            column = np.array([[reading.value] for _, reading in mine], dtype=np.float64)
            quality = min(reading.quality for _, reading in mine)
            self._newest_s[info] = float(times_s[-1])
            sink(
                Samples(
                    self.source, info, float(times_s[0]), column, times_s, ClockKind.RECORDING, 5.0, quality
                )
            )
