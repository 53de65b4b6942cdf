"""`handover bridge`: check a mapping, see what is on the ROS graph, write a mapping for a topic."""

import asyncio
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import httpx
import typer

from handover.command_line.access import access_headers, cli_access
from handover.errors import UsageError
from handover.network.tls_trust import client_context
from handover.settings import Settings
from handover_ros.settings import SERVICE, BridgeSettings

app = typer.Typer(
    help="The ROS bridge: check a mapping, see the graph, write a mapping.", no_args_is_help=True
)

DISCOVERY_WAIT_S = 3.0
"""Time for the discovery of nodes of other middleware."""
Answer = TypeVar("Answer")

WaitS = Annotated[float, typer.Option("--wait", min=0.1, help="Seconds for the discovery of the graph.")]


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="A mapping file, or the name of a shipped one.")],
    live: Annotated[bool, typer.Option("--live", help="Also check the graph: types, peers, QoS.")] = False,
    wait_s: WaitS = DISCOVERY_WAIT_S,
) -> None:
    """Print the effect of a mapping, or its faults with their positions.

    With --live, exit code 1 if the present graph keeps a rule from working.
    """
    from handover_ros import mapping  # noqa: PLC0415 - only this command needs it
    from handover_ros.graph.simulated_time import notes  # noqa: PLC0415
    from handover_ros.inspection import description  # noqa: PLC0415
    from handover_ros.rules import plan  # noqa: PLC0415

    settings = BridgeSettings.load()
    document = mapping.load(file)
    store = plan.type_store(document)
    if not live:
        for line in description.lines(plan.make(document, store, settings.factory)):
            print(line)
        return

    async def look(graph: Any) -> tuple[list[str], list[str]]:
        types = {topic.name: topic.type_names for topic in graph.topics()}
        made = plan.make(document, store, settings.factory, lambda topic: types.get(topic, ()))
        return [*description.lines(made), *notes(graph)], list(description.problems(made, graph))

    effect, problems = asyncio.run(on_the_graph(settings, store, wait_s, look))
    for line in (*effect, *problems):
        print(line)
    if problems:
        raise typer.Exit(1)


@app.command()
def graph(wait_s: WaitS = DISCOVERY_WAIT_S) -> None:
    """Print what is on the ROS graph, and the entities in the broker."""
    from handover_ros.inspection import graph_view  # noqa: PLC0415
    from handover_ros.types.type_store import TypeStore  # noqa: PLC0415

    settings = BridgeSettings.load()

    async def look(ros: Any) -> dict[str, Any]:
        return graph_view.of(ros)

    view = _asked_of_bridge("/graph")
    if view is not None and view.get("domain") not in {None, settings.ros_domain_id}:
        print(
            f"the running ROS bridge uses ROS domain {view['domain']}; this is domain "
            f"{settings.ros_domain_id} (ROS_DOMAIN_ID), without it",
            file=sys.stderr,
        )
        view = None
    if view is None:
        view = asyncio.run(on_the_graph(settings, TypeStore(), wait_s, look))
    for line in graph_view.lines(view):
        print(line)
    for line in asyncio.run(_entities(settings)):
        print(line)


@app.command()
def scaffold(
    topic: Annotated[str, typer.Argument(help="A published topic, such as /joint_states.")],
    type_name: Annotated[
        str | None, typer.Option("--type", help="Its type; then it need not be published now.")
    ] = None,
    wait_s: WaitS = DISCOVERY_WAIT_S,
) -> None:
    """Write a mapping for a topic to the standard output."""
    from handover_ros.inspection import scaffolding  # noqa: PLC0415
    from handover_ros.mapping import names  # noqa: PLC0415
    from handover_ros.types.type_store import TypeStore  # noqa: PLC0415

    settings, store = BridgeSettings.load(), TypeStore()
    try:
        wanted = names.topic(topic)
    except ValueError as error:
        raise UsageError(str(error)) from None
    if type_name is not None:
        print(scaffolding.mapping_for(wanted, store.resolve(type_name), None, store), end="")
        return

    async def look(ros: Any) -> Any:
        return next((sent for sent in ros.topics() if sent.name == wanted and sent.publishers), None)

    topic_seen = asyncio.run(on_the_graph(settings, store, wait_s, look))
    if topic_seen is None:
        raise UsageError(
            f"no node publishes {wanted} in ROS domain {settings.ros_domain_id}; start its node, set "
            "ROS_DOMAIN_ID, or name its type with --type"
        )
    if len(topic_seen.type_names) > 1:
        raise UsageError(
            f"{wanted} has the types {' and '.join(topic_seen.type_names)}; choose one with --type"
        )
    print(
        scaffolding.mapping_for(wanted, topic_seen.type_names[0], topic_seen.publishers[0].qos, store), end=""
    )


@app.command()
def definitions(
    topic: Annotated[str, typer.Argument(help="A topic whose type is not known here.")],
    to: Annotated[Path, typer.Option("--to", help="The folder to write to; name it in type_paths.")] = Path(
        "msgs"
    ),
    wait_s: WaitS = DISCOVERY_WAIT_S,
) -> None:
    """Learn the definition of a topic's type from the node that publishes it (ROS 2 Jazzy and later)."""
    from handover_ros.inspection import definition_retrieval  # noqa: PLC0415
    from handover_ros.types.type_store import TypeStore  # noqa: PLC0415

    async def look(ros: Any) -> Any:
        return await definition_retrieval.retrieve(ros, topic)

    retrieved = asyncio.run(on_the_graph(BridgeSettings.load(), TypeStore(), wait_s, look))
    definition_retrieval.write(retrieved, to)
    for name in sorted(retrieved):
        print(to / name)


async def on_the_graph(
    settings: BridgeSettings, store: Any, wait_s: float, look: Callable[[Any], Awaitable[Answer]]
) -> Answer:
    """Return what `look` returns with the graph, `wait_s` seconds after it was joined."""
    from handover_ros.joining import join  # noqa: PLC0415 - loads the middleware

    joined = await join(settings, store)
    try:
        await asyncio.sleep(wait_s)
        return await look(joined)
    finally:
        await joined.close()


def _asked_of_bridge(path: str) -> Any:
    """Return the answer of a running bridge; None without one."""
    try:
        answer = httpx.get(
            f"{SERVICE.url()}{path}",
            headers=access_headers(Settings.load()),
            timeout=5,
            trust_env=False,
            verify=client_context(*SERVICE.settings.load().ca_files),
        )
    except httpx.TransportError:
        return None
    return answer.json() if answer.is_success else None


async def _entities(settings: BridgeSettings) -> list[str]:
    from handover.broker import BrokerClient, BrokerError  # noqa: PLC0415

    try:
        async with cli_access(settings) as access, BrokerClient(settings, credentials=access) as broker:
            types = await broker.types()
    except BrokerError as error:
        return [f"the broker does not answer: {error}"]
    return [f"entities  {', '.join(types) if types else 'none'}"]
