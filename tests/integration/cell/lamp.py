"""A lamp that takes Tasks: the smallest component there can be."""

import asyncio
from typing import Any

from handover.component import serve
from handover.performer import Job, Performer


class Lamp(Performer):
    async def perform(self, job: Job) -> dict[str, Any]:
        steps = int(job.parameters.get("steps", 10))
        for step in range(steps):
            await asyncio.sleep(0.05)  # a real lamp would glow
            job.report_progress((step + 1) / steps)
            await job.checkpoint()  # rests here while paused; ends here when cancelled
        return {"lit": True}


if __name__ == "__main__":
    serve(Lamp, "lamp", acts_for=["Device:lamp-1"], port=9100)
