"""Security: who calls a service, and what the caller may do.

A service gives its `Guard` to `create_app`; each of its routes declares what it asks of the caller:

    of_robot = in_path("Device", "robot")

    @app.post("/robots/{robot}/jog", dependencies=[require(Permission.MOVE_ROBOTS, of_robot)])

- `permissions`, `resource_patterns`, `caller`: roles, grants and callers, as values.
- `access_tokens`: the signed tokens that services verify by themselves; `secret_tokens`: opaque tokens of
  devices, scripts and services, of which only the hash is stored.
- `local_mode`: requests of the same machine, while no account exists.
- `revocations`: what became invalid before it expired; `guard` combines all of these.
- `open_streams`: ends what stays open, when its caller loses what it was opened with.
- `proofs`: what `accounts` signs about a Task, so that it holds in every broker.
- `service_access`: the credentials of a service for its own requests.
- `audit`: records of changes, chained by hashes, in the transaction of the change; `audit_trail` records the
  requests of a service, `audit_reading` has the routes of a log, and the logs of all services.

`docs/adr/0017-identity-and-rights.md` has the decisions.
"""
