"""A node that uses handover_human_msgs as `rmw_cyclonedds_cpp` does, written against DDS alone.

It sends each `HeartRate` on `/said` back on `/echoed`, and each `Ecg` on `/wave_said` on `/wave_echoed`. The
structs are written by hand after the .msg files.

`genuine_human_peer.py DOMAIN` writes "ready" and runs until its input ends.
"""

import sys
import threading
from dataclasses import dataclass
from typing import Any

from cyclonedds.core import Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

CONFIGURATION = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface address="127.0.0.1" '
    'multicast="false"/></Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex>'
    '<MaxAutoParticipantIndex>100</MaxAutoParticipantIndex><Peers><Peer Address="127.0.0.1"/></Peers>'
    "</Discovery></Domain></CycloneDDS>"
)


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@final
@dataclass
class SignalInfo(IdlStruct, typename="handover_human_msgs::msg::dds_::SignalInfo_"):
    subject: str
    source: str
    method: str
    unit: str
    sampling_rate_hz: float64
    resolution: float64
    min_value: float64
    max_value: float64
    quality: float64
    validity: uint8
    clock: uint8
    clock_uncertainty_s: float64
    contact: uint8
    calibrated: bool


@final
@dataclass
class Samples(IdlStruct, typename="handover_human_msgs::msg::dds_::Samples_"):
    channels: sequence[str]
    values: sequence[float64]
    start_s: float64
    times_s: sequence[float64]


@final
@dataclass
class HeartRate(IdlStruct, typename="handover_human_msgs::msg::dds_::HeartRate_"):
    header: Header
    info: SignalInfo
    rate_bpm: float64


@final
@dataclass
class Ecg(IdlStruct, typename="handover_human_msgs::msg::dds_::Ecg_"):
    header: Header
    info: SignalInfo
    samples: Samples


def echo(participant: Any, kind: Any, said: str, echoed: str) -> None:
    qos = Qos(
        Policy.Reliability.Reliable(10**9),
        Policy.History.KeepLast(10),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    reader = DataReader(participant, Topic(participant, f"rt/{said}", kind), qos)
    writer = DataWriter(participant, Topic(participant, f"rt/{echoed}", kind), qos)

    def work() -> None:
        for received in reader.take_iter():
            writer.write(received)

    threading.Thread(target=work, daemon=True).start()


def main() -> None:
    number = int(sys.argv[1])
    domain = Domain(number, CONFIGURATION)
    participant = DomainParticipant(number, qos=Qos(Policy.Userdata(b"enclave=/;")))
    echo(participant, HeartRate, "said", "echoed")
    echo(participant, Ecg, "wave_said", "wave_echoed")
    print("ready", flush=True)
    sys.stdin.read()
    del participant, domain


main()
