"""Services over DDS, like `rmw_cyclonedds_cpp`: a header before each request and reply.

The header contains the id of the client (8 bytes, chosen by the client) and the number of the request. Fast
DDS transmits the same in another place, so the two cannot call each other. A call to a Fast DDS server is
refused before anything is sent (such a server would keep every request that it cannot answer).

`rmw_cyclonedds_cpp` publishes on each endpoint the hash of the *message* that it transmits, `X_Request` or
`X_Response`; other programs publish the hash of the service `X`. The bridge publishes the former and accepts
both.
"""

import secrets
import struct

from handover.distribution import install_command
from handover_ros.errors import TypeHashDiffers, VendorNotShared
from handover_ros.graph.cyclone import dds_names
from handover_ros.graph.cyclone.discovery import DiscoveredEndpoint
from handover_ros.types.type_store import TypeStore

VENDOR = "cyclonedds"
HEADER = struct.Struct("<Qq")
CDR_BYTES = 4


def wrapped(writer_guid: int, sequence: int, data: bytes) -> bytes:
    """Return a sample of CDR with the header of a request or reply."""
    return data[:CDR_BYTES] + HEADER.pack(writer_guid, sequence) + data[CDR_BYTES:]


def unwrapped(data: bytes) -> tuple[int, int, bytes]:
    """Return the id of the writer, the number of the request, and the sample without the header."""
    guid, sequence = HEADER.unpack_from(data, CDR_BYTES)
    return guid, sequence, data[:CDR_BYTES] + data[CDR_BYTES + HEADER.size :]


def id_of_pair() -> str:
    """Return a new id that the reader and the writer of a client or server share."""
    return ".".join(f"{byte:x}" for byte in secrets.token_bytes(16))


def vendor_refused(service: str, endpoint: DiscoveredEndpoint, node: str | None, doing: str) -> str:
    """Return the error text for a peer whose middleware has incompatible services."""
    return (
        f"{service}: {node or 'a node'} {doing} it with {endpoint.vendor}, whose services cannot be reached "
        "from Cyclone DDS; start it with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or install rclpy beside the "
        f"bridge ({install_command('ros', 'ros-rclpy')}, Python 3.11 on Linux) and leave "
        "HANDOVER_ROS_ADAPTER at auto"
    )


def hash_refused(
    store: TypeStore, service: str, base: str, server: DiscoveredEndpoint, node: str | None
) -> str | None:
    """Return the error text for a server with another definition of `base`; None if it has the same.

    The peer may publish the hash of the request message, of the service, or none.
    """
    name, theirs = dds_names.to_type(server.dds_type).removesuffix("_Request"), server.type_hash
    accepted = accepted_hashes(store, base)
    if name == base and (theirs is None or theirs in accepted):
        return None
    ours = ", ".join(f"{of} {digest}" for digest, of in accepted.items())
    return (
        f"{service}: {node or 'a node'} serves {name} with the type hash {theirs}, our {base} has {ours}; "
        "give the rule that type, or name the robot's definition in type_paths"
    )


def accepted_hashes(store: TypeStore, base: str) -> dict[str, str]:
    """Return the hashes that a request endpoint may publish, each with what it is the hash of."""
    return {store.hash(f"{base}_Request"): "request", store.hash(base): "service"}


def obstacle(
    store: TypeStore, service: str, base: str, server: DiscoveredEndpoint, node: str | None
) -> VendorNotShared | TypeHashDiffers | None:
    """Return why a server, given by its request reader, must not be called; None if it may be."""
    if server.vendor != VENDOR:
        return VendorNotShared(vendor_refused(service, server, node, "serves"))
    fault = hash_refused(store, service, base, server, node)
    return TypeHashDiffers(fault) if fault is not None else None
