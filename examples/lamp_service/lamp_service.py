"""A lamp that performs Tasks, as a service of its own."""

import asyncio
from typing import Any

from pydantic import Field

from handover.component import serve
from handover.extensions import Service
from handover.performer import Job, Performer
from handover.settings import Settings


class LampSettings(Settings):
    """Where the lamp listens and which Device it is."""

    lamp_port: int = Field(54900, ge=1, le=65535, description="HTTP port of the lamp")
    lamp_device: str = Field("Device:lamp-1", description="the Device that the lamp acts for")


class Lamp(Performer):
    """Shines for the parameter `steps` of its Task, ten steps a second."""

    async def perform(self, job: Job) -> dict[str, Any]:
        steps = int(job.parameters.get("steps", 10))
        for step in range(steps):
            await asyncio.sleep(0.1)  # a real lamp would shine
            job.report_progress((step + 1) / steps)
            await job.checkpoint()  # waits here while the Task is paused; ends here when it is cancelled
        return {"lit": True}


SERVICE = Service("lamp", "lamp_service", LampSettings, "lamp_port")

if __name__ == "__main__":
    settings = LampSettings.load()
    serve(Lamp, "lamp", acts_for=[settings.lamp_device], port=settings.lamp_port)
