"""Any board of BrainFlow: its own channels of ECG, EMG, EEG, EDA and PPG, with its time stamps.

BrainFlow gives biopotentials in microvolt whatever the board; the unit is stated so. It stamps samples on
this machine when they arrive, in s since 1970. A board that is switched off sends nothing, without an error:
the runner finds the silence and opens the session again.
"""

import asyncio
import warnings
from typing import Any, ClassVar, Final

import numpy as np
from pydantic import Field

from handover.distribution import install_command
from handover.errors import UsageError
from handover_body.drivers.base import DriverSettings, FoundDevice, LinkLost, SensorDriver, Sink, now_s
from handover_body.model.signals import (
    ClockKind,
    LinkState,
    Samples,
    SensorReport,
    SignalInfo,
    SignalKind,
)

PULL_S: Final = 0.1
SYNTHETIC: Final = -1
BUFFER_S: Final = 30
KINDS: Final = {
    "ecg": (SignalKind.ECG, "D82"),
    "emg": (SignalKind.EMG, "D82"),
    "eeg": (SignalKind.EEG, "D82"),
    "eog": (SignalKind.EOG, "D82"),
    "eda": (SignalKind.EDA, "D80"),
    "ppg": (SignalKind.PPG, "C62"),
}


class BrainFlowSettings(DriverSettings):
    """Which board (BrainFlow's number, -1 is the synthetic one) and which of its signals."""

    board_id: int = SYNTHETIC
    signals: tuple[str, ...] = Field(("ecg",), min_length=1)
    serial_port: str = ""
    mac_address: str = ""
    ip_address: str = ""
    ip_port: int = Field(0, ge=0, le=65_535)
    serial_number: str = ""
    master_board: int | None = None


class BrainFlowDriver(SensorDriver):
    """One board. BrainFlow does not reconnect; the session is released and prepared again."""

    settings_model: ClassVar[type[DriverSettings]] = BrainFlowSettings
    max_latency_s = 0.1

    def __init__(self, source: str, settings: BrainFlowSettings) -> None:
        super().__init__(source, settings)
        shim = _brainflow()
        self._shim = shim
        board = settings.board_id if settings.master_board is None else settings.master_board
        try:
            self._rate_hz = float(shim.BoardShim.get_sampling_rate(board))
            self._time_row = int(shim.BoardShim.get_timestamp_channel(board))
            self._rows = {name: self._channels(board, name) for name in settings.signals}
        except shim.BrainFlowError as error:
            raise UsageError(
                f"the BrainFlow board {board} has not all of {', '.join(settings.signals)}: {error}; "
                "choose others in `signals`"
            ) from error
        self._infos = {
            name: SignalInfo(
                KINDS[name][0],
                KINDS[name][1],
                self._rate_hz,
                tuple(map(str, rows)),
                method="BrainFlow",
            )
            for name, rows in self._rows.items()
        }

    def _channels(self, board: int, name: str) -> list[int]:
        if name not in KINDS:
            raise UsageError(f'"{name}" is no signal of a board; choose from {", ".join(KINDS)}')
        rows = getattr(self._shim.BoardShim, f"get_{name}_channels")(board)
        return [int(row) for row in rows]

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        return tuple(self._infos.values())

    async def run(self, sink: Sink) -> None:
        shim, settings = self._shim, self.settings
        shim.BoardShim.disable_board_logger()
        parameters = shim.BrainFlowInputParams()
        for name in ("serial_port", "mac_address", "ip_address", "ip_port", "serial_number"):
            setattr(parameters, name, getattr(settings, name))
        if settings.master_board is not None:
            parameters.master_board = settings.master_board
        board = shim.BoardShim(settings.board_id, parameters)
        try:
            await asyncio.to_thread(board.prepare_session)
            await asyncio.to_thread(board.start_stream, round(BUFFER_S * self._rate_hz))
            sink(SensorReport(self.source, now_s(), link=LinkState.CONNECTED))
            while True:
                await asyncio.sleep(PULL_S)
                data = board.get_board_data()
                if data.shape[1]:
                    self._pass_on(data, sink)
        except shim.BrainFlowError as error:
            raise LinkLost(f"the board failed: {error}") from error
        finally:
            await asyncio.shield(asyncio.to_thread(_release, board))

    def _pass_on(self, data: np.ndarray, sink: Sink) -> None:
        count = data.shape[1]
        # A board stamps bursts: their times are equal, so the newest one and the rate give those of all.
        start_s = float(data[self._time_row, -1]) - (count - 1) / self._rate_hz
        for name, info in self._infos.items():
            values = np.ascontiguousarray(data[self._rows[name]].T)
            sink(Samples(self.source, info, start_s, values, clock=ClockKind.ARRIVAL))

    @classmethod
    async def discover(cls, timeout_s: float) -> list[FoundDevice]:
        """Return the synthetic board: BrainFlow has no search, boards are named by their number."""
        return [FoundDevice(str(SYNTHETIC), "BrainFlow synthetic board")]


def _release(board: Any) -> None:
    if board.is_prepared():
        board.release_session()


def _brainflow() -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it uses pkg_resources, which is deprecated
            from brainflow import board_shim  # type: ignore[import-untyped]  # noqa: PLC0415 - of the extra

            board_shim.BoardShim.get_version()  # loads its library, with pkg_resources
    except ImportError:
        raise UsageError(f"BrainFlow boards need the extra: {install_command('body')}") from None
    return board_shim
