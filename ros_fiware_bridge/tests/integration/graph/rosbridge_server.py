"""A rosbridge server that connects its clients, as a peer for our client.

PyPI has no rosbridge server, so this one implements the published protocol (version 2, with the actions of
ROS 2). Each client is a node; a genuine server would list all of them as one node.
"""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from tests.kit.waiting import scaled

ROSAPI = "/rosapi/"


class Client:
    """A connected client and its topics, services and actions."""

    def __init__(self, name: str, socket: ServerConnection) -> None:
        self.name = name
        self.socket = socket
        self.publishing: dict[str, tuple[str, bool]] = {}
        self.subscribing: dict[str, dict[str, Any]] = {}
        self.services: dict[str, str] = {}
        self.actions: dict[str, str] = {}

    async def send(self, **operation: Any) -> None:
        text = json.dumps(operation)
        size = (self.subscribing.get(operation.get("topic", "")) or {}).get("fragment_size")
        with suppress(ConnectionClosed):
            if not size or len(text) <= size:
                await self.socket.send(text)
                return
            parts = [text[at : at + size] for at in range(0, len(text), size)]
            for number, part in enumerate(parts):
                fragment = {"op": "fragment", "id": str(id(text)), "data": part, "num": number}
                await self.socket.send(json.dumps({**fragment, "total": len(parts)}))


class RosbridgeServer:
    """Forwards operations between clients; `ros1` selects the format of type names."""

    def __init__(self, *, ros1: bool = False) -> None:
        self.ros1 = ros1
        self.port = 0
        self._clients: list[Client] = []
        self._latched: dict[str, Any] = {}
        self._calls: dict[str, tuple[Client, str | None]] = {}
        self._goals: dict[str, tuple[Client, Client]] = {}
        self._names = 0
        self._server: Server | None = None

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.port}"

    async def start(self) -> None:
        self._server = await serve(self._meet, "127.0.0.1", self.port, max_size=None)
        self.port = next(iter(self._server.sockets)).getsockname()[1]

    async def stop(self) -> None:
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()
            self._latched.clear()

    async def _meet(self, socket: ServerConnection) -> None:
        self._names += 1
        client = Client(f"/client_{self._names}", socket)
        self._clients.append(client)
        try:
            async for text in socket:
                await self._take(client, json.loads(text))
        except ConnectionClosed:
            pass
        finally:
            self._clients.remove(client)

    async def _take(self, client: Client, asked: dict[str, Any]) -> None:
        match asked["op"]:
            case "advertise":
                client.publishing[asked["topic"]] = (asked["type"], asked.get("latch", False))
            case "unadvertise":
                client.publishing.pop(asked["topic"], None)
            case "subscribe":
                client.subscribing[asked["topic"]] = asked
                if asked["topic"] in self._latched:
                    await client.send(op="publish", topic=asked["topic"], msg=self._latched[asked["topic"]])
            case "unsubscribe":
                client.subscribing.pop(asked["topic"], None)
            case "publish":
                await self._publish(client, asked)
            case "advertise_service" | "advertise_action" as op:
                what = op.removeprefix("advertise_")
                getattr(client, f"{what}s")[asked[what]] = asked["type"]
            case "unadvertise_service" | "unadvertise_action" as op:
                what = op.removeprefix("unadvertise_")
                getattr(client, f"{what}s").pop(asked[what], None)
            case "call_service":
                await self._call(client, asked)
            case "service_response" if asked["id"] in self._calls:
                caller, theirs = self._calls.pop(asked["id"])
                await caller.send(**{**asked, "id": theirs})
            case "send_action_goal" | "cancel_action_goal" | "action_feedback" | "action_result":
                await self._action(client, asked)
            case _:
                await client.send(op="status", level="error", msg=f"Unknown operation: {asked['op']}.")

    async def _publish(self, client: Client, asked: dict[str, Any]) -> None:
        topic = asked["topic"]
        if client.publishing.get(topic, ("", False))[1]:
            self._latched[topic] = asked["msg"]
        for other in list(self._clients):
            if topic in other.subscribing:
                await other.send(op="publish", topic=topic, msg=asked["msg"])

    async def _call(self, client: Client, asked: dict[str, Any]) -> None:
        service, number = asked["service"], f"{len(self._calls)}-{client.name}-{asked.get('id')}"
        answer = {"op": "service_response", "id": asked.get("id"), "service": service}
        if service.startswith(ROSAPI):
            await client.send(**answer, values=self._rosapi(service.removeprefix(ROSAPI), asked), result=True)
            return
        server = next((one for one in self._clients if service in one.services), None)
        if server is None:
            await client.send(**answer, values=f"Service {service} does not exist", result=False)
            return
        self._calls[number] = (client, asked.get("id"))
        await server.send(op="call_service", id=number, service=service, args=asked.get("args", {}))

    async def _action(self, client: Client, asked: dict[str, Any]) -> None:
        goal = asked["id"]
        if asked["op"] == "send_action_goal":
            server = next((one for one in self._clients if asked["action"] in one.actions), None)
            if server is None or asked["args"].get("order") == 13:
                why = "Action goal was rejected" if server else f"no server of {asked['action']}"
                result = {"op": "action_result", "id": goal, "action": asked["action"]}
                await client.send(**result, values=why, status=0, result=False)
                return
            self._goals[goal] = (client, server)
            await server.send(**asked)
        elif goal in self._goals:
            sender, server = self._goals[goal]
            await (server if asked["op"] == "cancel_action_goal" else sender).send(**asked)

    def _rosapi(self, what: str, asked: dict[str, Any]) -> dict[str, Any]:
        given = asked.get("args", {})
        match what:
            case "topics":
                types = {topic: kind for one in self._clients for topic, (kind, _) in one.publishing.items()}
                types |= {
                    topic: sub["type"] for one in self._clients for topic, sub in one.subscribing.items()
                }
                for one in self._clients:
                    for action, kind in one.actions.items():
                        types[f"{action}/_action/feedback"] = f"{kind}_FeedbackMessage"
                types["/rosout"] = "rosgraph_msgs/Log" if self.ros1 else "rcl_interfaces/msg/Log"
                return {"topics": list(types), "types": list(types.values())}
            case "nodes":
                return {"nodes": [one.name for one in self._clients]}
            case "node_details":
                (one,) = (one for one in self._clients if one.name == given["node"])
                feedback = [f"{action}/_action/feedback" for action in one.actions]
                return {
                    "publishing": [*one.publishing, *feedback],
                    "subscribing": list(one.subscribing),
                    "services": list(one.services),
                }
            case "service_type":
                return {
                    "type": next(
                        one.services[given["service"]]
                        for one in self._clients
                        if given["service"] in one.services
                    )
                }
        raise AssertionError(what)


@asynccontextmanager
async def running(*, ros1: bool = False) -> AsyncIterator[RosbridgeServer]:
    server = RosbridgeServer(ros1=ros1)
    await server.start()
    try:
        yield server
    finally:
        await asyncio.wait_for(server.stop(), scaled(10))
