"""The names of ROS topics, services and types on DDS.

Topics have the prefix `rt`, requests `rq`, replies `rr`; a type `pkg/msg/X` is `pkg::msg::dds_::X_`.
"""

DISCOVERY_TOPIC = "ros_discovery_info"
DISCOVERY_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"

_VENDORS = {
    b"\x01\x01": "connext",
    b"\x01\x02": "opensplice",
    b"\x01\x03": "opendds",
    b"\x01\x0f": "fastdds",
    b"\x01\x10": "cyclonedds",
    b"\x01\x11": "gurumdds",
    b"\x01\x12": "rustdds",
}


def of_topic(name: str) -> str:
    """Return the DDS topic of a ROS topic."""
    return f"rt{name}"


def of_request(name: str) -> str:
    """Return the DDS topic that carries the requests of a service."""
    return f"rq{name}Request"


def of_reply(name: str) -> str:
    """Return the DDS topic that carries the replies of a service."""
    return f"rr{name}Reply"


def of_type(type_name: str) -> str:
    """Return the DDS type of a ROS message type."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def to_topic(dds_topic: str) -> str | None:
    """Return the ROS topic of a DDS topic; None if it has none."""
    return dds_topic.removeprefix("rt") if dds_topic.startswith("rt/") else None


def to_service(dds_topic: str) -> tuple[str, bool] | None:
    """Return the service of a DDS topic and whether it carries requests; None for other topics."""
    if dds_topic.startswith("rq/") and dds_topic.endswith("Request"):
        return dds_topic[2 : -len("Request")], True
    if dds_topic.startswith("rr/") and dds_topic.endswith("Reply"):
        return dds_topic[2 : -len("Reply")], False
    return None


def to_type(dds_type: str) -> str:
    """Return the ROS type of a DDS type; other DDS types are returned unchanged."""
    parts = dds_type.split("::")
    if len(parts) == 4 and parts[2] == "dds_" and parts[3].endswith("_"):
        return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"
    return dds_type


def vendor(guid: bytes) -> str:
    """Return the middleware of a participant, from the vendor id at the start of its GUID."""
    return _VENDORS.get(guid[:2], f"vendor {guid[:2].hex()}")


def user_data(pairs: dict[str, str]) -> bytes:
    """Return the user data of a participant or endpoint, `key=value;key=value;`."""
    return "".join(f"{key}={value};" for key, value in pairs.items()).encode()


def parse_user_data(data: bytes) -> dict[str, str]:
    """Return the pairs in the user data of a participant or endpoint; malformed parts are left out."""
    pairs = (part.partition("=") for part in data.decode("utf-8", "replace").split(";"))
    return {key: value for key, is_present, value in pairs if is_present}
