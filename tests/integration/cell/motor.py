"""A performer of a stranger: it sends a command in each cycle, and writes down each one with its process.

`MOTOR_COMMANDS` is the file of all commands, which several processes share: `pid task step`.
"""

import asyncio
import os
from pathlib import Path
from typing import Any

from handover.component import serve
from handover.performer import Job, Performer

COMMANDS = Path(os.environ["MOTOR_COMMANDS"])
CYCLE_S = 0.02
REPEATS = os.environ.get("MOTOR_REPEATS") == "yes"


class Motor(Performer):
    """Turns for the parameter `steps` of its Task."""

    async def may_repeat(self, job: Job) -> bool:
        return REPEATS or await super().may_repeat(job)

    async def perform(self, job: Job) -> dict[str, Any]:
        steps = int(job.parameters["steps"])
        for step in range(steps):
            await asyncio.sleep(CYCLE_S)
            while not job.may_continue():
                await job.checkpoint()
            if job.may_act():
                with COMMANDS.open("a") as file:
                    file.write(f"{os.getpid()} {job.task.id.rpartition(':')[2]} {step}\n")
            job.report_progress((step + 1) / steps)
        return {"turned": steps}


if __name__ == "__main__":
    serve(Motor, "motor", acts_for=["Device:motor-1"], port=int(os.environ["MOTOR_PORT"]))
