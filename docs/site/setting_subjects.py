"""The subjects under which the reference lists the settings, and the settings of each.

A subject has names of settings, or the beginnings of names, which end with `_`; of two that fit, the longer
one counts. A setting that fits none is reported with this file.
"""

from collections.abc import Iterable, Mapping

OTHERS = "Addresses and ports of the services"
"""The subject of every `…_port` and `…_url` that no other subject names."""

SUBJECTS: Mapping[str, tuple[str, ...]] = {
    "The cell": (
        *("factory", "host", "data_dir", "log_", "extra_services", "emergency_stop", "cell_tenants"),
        *("secrets_dir", "reconcile_s"),
    ),
    "Databases and standby": (
        *("database_", "broker_database_url", "specification_url", "specification_timeout_s"),
        *("instance", "standby"),
    ),
    "The broker that the cell uses": (
        *("broker_url", "broker_token_file", "broker_headers", "broker_oauth_", "broker_tenant"),
        *("context_url", "notification_key"),
    ),
    "The embedded broker": ("broker_",),
    "TLS, proxies and reachable addresses": (
        *("tls_", "public_tls_", "authority_dir", "trusted_proxies", "allowed_", "outbound_allow"),
        "component_url",
    ),
    "Limits of requests and connections": ("http_", "tls_handshake_timeout_s"),
    "Accounts, sessions and audit": (
        *("security_dir", "service_token", "service_token_file", "session_", "link_valid_h"),
        *("password_workers", "audit_retention_days"),
    ),
    "Sign-in with OpenID Connect": ("oidc_",),
    "Processes and Tasks": (
        *("process_dir", "mapping_file", "task_deadline_s", "performer_grace_s", "cancel_grace_s"),
        *("message_ttl_s", "resources_need_acceptance", "retention_h", "keep_days"),
        *("device_leases", "lease_urls"),
    ),
    "Gloves and gestures": (
        *("glove_", "gestures_file", "announce_ms", "confirm_ms", "hands_apart_ms"),
        *("sequence_within_ms", "filtering", "recognizer", "silence_s"),
        *("max_gloves", "max_undeclared_gloves"),
    ),
    "Robots and scenes": (
        *("cell_file", "robot", "robot_", "scene_file", "control_hz", "neighbour_wait_s"),
        *("simulation_pace", "scan_seed", "detection_rate"),
    ),
    "Limits of robots": ("limit_sources", "people_", "separation_hold_s"),
    "ROS 2": ("ros_", "rosbridge_url", "bridge_name"),
    "Devices": ("device_", "gateway_replica_host"),
    "Edges": ("edge_",),
    "Alerts to people": ("alert_routes", "alert_retention_days", "smtp_"),
    "Body signals": ("health_",),
    "Case studies": ("assistive_machines", "assistive_ros_domain", "trainer_"),
    "Humanoids": ("humanoid_",),
    OTHERS: (),
}


def subject_of(name: str) -> str:
    """Return the subject of a setting; raise `SystemExit` if it fits none."""
    matches = [
        (len(entry), subject)
        for subject, entries in SUBJECTS.items()
        for entry in entries
        if name == entry or (entry.endswith("_") and name.startswith(entry))
    ]
    if matches:
        return max(matches)[1]
    if name.endswith(("_port", "_url")):
        return OTHERS
    raise SystemExit(f"the setting {name} has no subject; add it to one in docs/site/setting_subjects.py")


def by_subject(names: Iterable[str]) -> Mapping[str, list[str]]:
    """Return the settings of each subject, in the order of `names`."""
    grouped: dict[str, list[str]] = {subject: [] for subject in SUBJECTS}
    for name in names:
        grouped[subject_of(name)].append(name)
    return grouped
