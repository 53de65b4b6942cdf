"""The performer of a cell of `benchmarks.cell.many_cells`: it does each Task at once."""

import os
from collections.abc import Mapping
from typing import Any

from handover.component import serve
from handover.performer import Job, Performer


class AtOnce(Performer):
    """Completes each Task without work."""

    async def perform(self, job: Job) -> Mapping[str, Any]:  # noqa: ARG002
        """Return no outputs."""
        return {}


if __name__ == "__main__":
    serve(AtOnce, "robot", acts_for=["Device:robot-1"], port=int(os.environ["PERFORMER_PORT"]))
