"""REST and WebSocket: models, the state of the humanoid, stop and reset, behaviours and throws."""

import asyncio
import math
import time
from contextlib import suppress
from typing import Annotated, Any, Final

import orjson
from fastapi import FastAPI, Response, WebSocket
from starlette.websockets import WebSocketDisconnect

from handover.errors import Problem, UsageError
from handover.http.api_description import TaggedRoutes, sends
from handover.security.act_recording import lowers
from handover.security.caller import Caller
from handover.security.guard import require, require_somewhere
from handover.security.permissions import Permission
from handover_humanoid.behaviours.component_state import Behaviour
from handover_humanoid.behaviours.humanoid_component import behaviours_of
from handover_humanoid.robots import HUMANOIDS, humanoid
from handover_humanoid.routes.access import of_humanoid
from handover_humanoid.routes.bodies import (
    BehaviourRequest,
    ChainGainsView,
    GainsRequest,
    HumanoidView,
    LimitSourceView,
    ModelView,
    StateView,
    StopRequest,
    ThrowRequest,
    ThrowView,
)
from handover_humanoid.running.gains import Shares
from handover_humanoid.running.humanoid_control import HumanoidControl
from handover_humanoid.running.live_pace import Pace
from handover_humanoid.running.model_view import model_view
from handover_humanoid.running.motion import NAMES

LIVE_HZ: Final = 30.0
MAX_LIVE_HZ: Final = 120.0
"""Of a headset."""


def add_humanoid_routes(app: FastAPI, control: HumanoidControl) -> None:
    """Add the routes of the humanoid."""
    _add_models(app, control)
    _add_acts(app, control)
    _add_gains(app, control)
    _add_limits(app, control)
    _add_live(app, control)


def _add_models(app: FastAPI, control: HumanoidControl) -> None:
    routes = TaggedRoutes(app, "humanoid")
    see = [require(Permission.READ, of_humanoid)]

    @routes.get("/humanoids", dependencies=[require_somewhere(Permission.READ)])
    async def humanoids() -> list[HumanoidView]:
        """Return the installed models; all are simulated. `problem` says what a model lacks."""
        return await asyncio.to_thread(lambda: [_humanoid_view(name, control) for name in HUMANOIDS.names()])

    @routes.get("/model", dependencies=see)
    async def model() -> ModelView:
        """Return chains, joints with limits and gains, sensors, contacts, stacks of tasks, default poses."""
        return ModelView.model_validate(model_view(control.model))

    @routes.get("/model/urdf", dependencies=see, response_class=Response, responses=sends("application/xml"))
    async def urdf() -> Response:
        """Return the URDF."""
        return Response(control.model.urdf, media_type="application/xml")

    @routes.get("/state", dependencies=see)
    async def state() -> dict[str, Any]:
        """Return the newest live document; `fault` says when it is not live."""
        return control.document()

    @routes.get("/cycle", dependencies=see)
    async def cycle() -> StateView:
        """Return whether the control cycle runs, how often it was started or found, and the stop."""
        return _state_view(control)


def _add_acts(app: FastAPI, control: HumanoidControl) -> None:
    routes = TaggedRoutes(app, "humanoid")

    @routes.post("/stop")
    @lowers()
    async def stop(
        caller: Annotated[Caller, require(Permission.PERFORM_TASKS, of_humanoid)],
        body: StopRequest | None = None,
    ) -> StateView:
        """Finish the step and stand on both feet until a reset. This is no emergency stop."""
        await control.stop(caller, (body or StopRequest()).reason)
        return _state_view(control)

    @routes.post("/reset", dependencies=[require(Permission.MOVE_ROBOTS, of_humanoid)])
    async def reset() -> StateView:
        """Release the stop; 409 while a limit still stops the robot. It moves only by a further request."""
        await control.reset()
        return _state_view(control)

    @routes.post("/restart", dependencies=[require(Permission.MOVE_ROBOTS, of_humanoid)])
    async def restart() -> StateView:
        """Start the control cycle again after it has ended, or after a fall; 409 while it runs."""
        await control.restart()
        return _state_view(control)

    @routes.post("/behaviour", dependencies=[require(Permission.MOVE_ROBOTS, of_humanoid)])
    async def behaviour(body: BehaviourRequest) -> StateView:
        """Choose what the robot does; 409 while it does not stand on both feet."""
        control.choose(body.behaviour)
        return _state_view(control)

    @routes.post("/throws", dependencies=[require(Permission.MOVE_ROBOTS, of_humanoid)])
    async def throw(body: ThrowRequest) -> ThrowView:
        """Throw a ball now, or after the rehearsal of a hand that has not thrown yet.

        409 while the robot is stopped or does not juggle, 422 if the place is out of reach.
        """
        number = await control.throws.throw(body.target, body.hand)
        return ThrowView(number=number, is_preparing=control.throws.is_pending(number))


def _add_gains(app: FastAPI, control: HumanoidControl) -> None:
    routes = TaggedRoutes(app, "gains")
    change = [require(Permission.CONFIGURE, of_humanoid)]

    @routes.get("/gains", dependencies=[require(Permission.READ, of_humanoid)])
    async def gains() -> list[ChainGainsView]:
        """Return the gains of each chain as shares of those of the model, with the limits of the model."""
        return _gains_view(control)

    @routes.put("/gains", dependencies=change)
    async def change_gains(body: GainsRequest) -> list[ChainGainsView]:
        """Change the gains of chains; the joints follow within a second or so. 422 outside of the limits."""
        wanted = {chain: Shares(shares.stiffness, shares.damping) for chain, shares in body.chains.items()}
        await control.change_gains(wanted)
        return _gains_view(control)

    @routes.delete("/gains", dependencies=change)
    async def reset_gains() -> list[ChainGainsView]:
        """Return to the gains of the model."""
        await control.reset_gains()
        return _gains_view(control)


def _gains_view(control: HumanoidControl) -> list[ChainGainsView]:
    model = control.model
    return [
        ChainGainsView(
            chain=chain,
            joints=[model.joint_names[index] for index in model.tunable[chain]],
            stiffness=shares.stiffness,
            damping=shares.damping,
            stiffness_limits=model.gain_limits[chain].stiffness,
            damping_limits=model.gain_limits[chain].damping,
        )
        for chain, shares in control.gains.by_chain.items()
    ]


def _add_limits(app: FastAPI, control: HumanoidControl) -> None:
    routes = TaggedRoutes(app, "limits")

    @routes.get("/limits", dependencies=[require(Permission.READ, of_humanoid)])
    async def limits() -> list[LimitSourceView]:
        """Return the sources of speed limits; none of them is a safety-rated function."""
        return [
            LimitSourceView(
                source=limit.rule,
                fraction=round(limit.fraction, 4),
                reason=str(limit.reason),
                needs_reset=limit.needs_reset,
            )
            for limit in control.limits.limits.allowed(time.monotonic())
        ]

    @routes.delete(
        "/limits/{source}", status_code=204, dependencies=[require(Permission.MOVE_ROBOTS, of_humanoid)]
    )
    async def remove(source: str) -> None:
        """Require a source no longer, for example after its person was unbound."""
        if not control.limits.limits.remove(source):
            raise Problem.translated(
                404,
                "No such source",
                "humanoid.no_such_source",
                'no source "{source}" limits the humanoid',
                source=source,
            )
        control.update_limit()


def _add_live(app: FastAPI, control: HumanoidControl) -> None:
    @app.websocket("/live", dependencies=[require(Permission.READ, of_humanoid)])
    async def live(socket: WebSocket) -> None:
        """Send the live document 30 times a second, or `?hz=` times; a slow reader gets fewer.

        From 60 a second, a document also follows each pose of the person, before the next frame of a headset.
        """
        await socket.accept()
        period_s = 1.0 / _rate(socket.query_params.get("hz"))
        sending = asyncio.create_task(_send(socket, control, period_s))
        try:
            with suppress(WebSocketDisconnect, RuntimeError, KeyError):
                while not sending.done():
                    await socket.receive_text()
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)


async def _send(socket: WebSocket, control: HumanoidControl, period_s: float) -> None:
    with control.inputs.poses.followed() as pose:
        pace = Pace(period_s, pose)
        while True:
            try:
                await socket.send_text(orjson.dumps(control.document()).decode())
            except (WebSocketDisconnect, RuntimeError):
                return
            await pace.next()


def _rate(written: str | None) -> float:
    try:
        hz = LIVE_HZ if written is None else float(written)
    except ValueError:
        hz = math.nan
    return min(hz, MAX_LIVE_HZ) if hz > 0 else LIVE_HZ


def _humanoid_view(name: str, control: HumanoidControl) -> HumanoidView:
    runs = name == control.model.name
    try:
        model = control.model if runs else humanoid(name)
        offered = control.offered if runs else behaviours_of(model)
    except UsageError as error:  # for example without the package of its URDF
        return HumanoidView(
            model=name,
            name=None,
            is_running=False,
            joints=0,
            mass_kg=0.0,
            hands=[],
            behaviours=[],
            drivers=[],
            problem=str(error),
        )
    return HumanoidView(
        model=name,
        name=control.name if runs else None,
        is_running=runs and control.process.is_running,
        joints=len(model.joints),
        mass_kg=round(model.mass_kg, 3),
        hands=list(model.grips),
        behaviours=[behaviour for behaviour, code in NAMES.items() if Behaviour(code) in offered],
        drivers=["simulated"],
        problem=_problem(control) if runs else "",
    )


def _state_view(control: HumanoidControl) -> StateView:
    return StateView(
        is_stopped=control.motion.stopped is not None,
        is_running=control.process.is_running,
        problem=_problem(control),
        starts=control.process.starts,
        pid=control.process.pid,
    )


def _problem(control: HumanoidControl) -> str:
    return "" if control.problem is None else str(control.problem[1])
