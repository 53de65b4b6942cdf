"""A node as `rmw_cyclonedds_cpp` makes it, written against DDS alone: without our adapter.

It serves `/trigger` (std_srvs/srv/Trigger) and the action `/fibonacci` (test_msgs/action/Fibonacci). Each of
its endpoints publishes, as that middleware does, the hash of the message it carries. The hashes are those in
the type descriptions of ROS 2 Jazzy (`share/std_srvs/srv/Trigger.json` and the like).

`genuine_cyclone.py DOMAIN [HASH_OF_TRIGGER_REQUEST]` writes "ready" and runs until its input ends.
"""

import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cyclonedds.core import Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, int8, int32, int64, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

# The names of members are ours: Cyclone compares descriptions where both sides have one. Genuine nodes
# publish none of services, so there only the bytes count, which names do not change.


@final
@dataclass
class Uuid(IdlStruct, typename="unique_identifier_msgs::msg::dds_::UUID_"):
    uuid: array[uint8, 16]


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@final
@dataclass
class Goal(IdlStruct, typename="test_msgs::action::dds_::Fibonacci_Goal_"):
    order: int32


@final
@dataclass
class Result(IdlStruct, typename="test_msgs::action::dds_::Fibonacci_Result_"):
    sequence: sequence[int32]


@final
@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    handover_writer_guid: uint64
    handover_sequence: int64


@final
@dataclass
class TriggerResponse(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    handover_writer_guid: uint64
    handover_sequence: int64
    success: bool
    message: str


@final
@dataclass
class SendGoalRequest(IdlStruct, typename="test_msgs::action::dds_::Fibonacci_SendGoal_Request_"):
    handover_writer_guid: uint64
    handover_sequence: int64
    goal_id: Uuid
    goal: Goal


@final
@dataclass
class SendGoalResponse(IdlStruct, typename="test_msgs::action::dds_::Fibonacci_SendGoal_Response_"):
    handover_writer_guid: uint64
    handover_sequence: int64
    accepted: bool
    stamp: Time


@final
@dataclass
class GetResultRequest(IdlStruct, typename="test_msgs::action::dds_::Fibonacci_GetResult_Request_"):
    handover_writer_guid: uint64
    handover_sequence: int64
    goal_id: Uuid


@final
@dataclass
class GetResultResponse(IdlStruct, typename="test_msgs::action::dds_::Fibonacci_GetResult_Response_"):
    handover_writer_guid: uint64
    handover_sequence: int64
    status: int8
    result: Result


HASHES = {
    TriggerRequest: "d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199",
    TriggerResponse: "2d946c21e2fc3f1e9ca6986a8191d85fcc70097a8bb7771a053564bc47009cdf",
    SendGoalRequest: "dfe75c73dc2c090cbc8fd8c45039bfa279d16aa6aadd348f812c6adad26e669e",
    SendGoalResponse: "1e7e84f7edf1fb020d9e51c7842bceef4cbdbd847f354125f3227cf4f314a683",
    GetResultRequest: "c65e93c4c4328d7f1abd6ace83dba8e5fa0f32de76b4d2c96b5c655d94803b92",
    GetResultResponse: "ef88159d47a3d21d9bf4bec690cf668939d9542db28a9cfd77dbcd97eaf1add2",
}
CONFIGURATION = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface address="127.0.0.1" '
    'multicast="false"/></Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex>'
    '<MaxAutoParticipantIndex>100</MaxAutoParticipantIndex><Peers><Peer Address="127.0.0.1"/></Peers>'
    "</Discovery></Domain></CycloneDDS>"
)


def serve(
    participant: Any, name: str, request: Any, response: Any, answer: Callable[[Any], tuple[Any, ...]]
) -> threading.Thread:
    def qos(kind: Any) -> Qos:
        data = f"serviceid=1.2.3.4.5.6.7.8.9.a.b.c.d.e.f.10;typehash=RIHS01_{HASHES[kind]};"
        return Qos(
            Policy.Reliability.Reliable(10**9),
            Policy.History.KeepLast(10),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(data.encode()),
        )

    writer = DataWriter(participant, Topic(participant, f"rr{name}Reply", response), qos(response))
    reader = DataReader(participant, Topic(participant, f"rq{name}Request", request), qos(request))

    def work() -> None:
        for asked in reader.take_iter():
            writer.write(response(asked.handover_writer_guid, asked.handover_sequence, *answer(asked)))

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def fibonacci(order: int) -> list[int]:
    numbers = [0, 1]
    while len(numbers) < order:
        numbers.append(numbers[-1] + numbers[-2])
    return numbers


def main() -> None:
    number = int(sys.argv[1])
    if len(sys.argv) > 2:
        HASHES[TriggerRequest] = sys.argv[2]
    domain = Domain(number, CONFIGURATION)
    participant = DomainParticipant(number, qos=Qos(Policy.Userdata(b"enclave=/;")))
    orders: dict[bytes, int] = {}

    def send_goal(asked: Any) -> tuple[Any, ...]:
        orders[bytes(asked.goal_id.uuid)] = asked.goal.order
        return True, Time(1, 2)

    def get_result(asked: Any) -> tuple[Any, ...]:
        return 4, Result(fibonacci(orders[bytes(asked.goal_id.uuid)]))

    action = "/fibonacci/_action"
    serve(participant, "/trigger", TriggerRequest, TriggerResponse, lambda _: (True, "done"))
    serve(participant, f"{action}/send_goal", SendGoalRequest, SendGoalResponse, send_goal)
    serve(participant, f"{action}/get_result", GetResultRequest, GetResultResponse, get_result)
    print("ready", flush=True)
    sys.stdin.read()
    del participant, domain


main()
