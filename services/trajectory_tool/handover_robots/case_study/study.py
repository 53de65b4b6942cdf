"""All trials of the case study, on several processes."""

import asyncio
import multiprocessing
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path

from handover.runtime.python_processes import safe_path_in_workers
from handover_robots.case_study.trial import Mode, Outcome, Trial


def perform(thing: str, mode: Mode, seed: int, recordings: Path | None = None) -> Outcome:
    """Perform one trial, and measure its CPU time."""
    began_s = time.process_time()
    outcome = asyncio.run(Trial(thing, mode, seed, recordings).run())
    return replace(outcome, cpu_s=time.process_time() - began_s)


def perform_all(
    things: Sequence[str], modes: Sequence[Mode], seeds: Sequence[int], recordings: Path | None, jobs: int
) -> Iterator[Outcome]:
    """Yield the outcomes in the order of seeds, things and modes."""
    context = multiprocessing.get_context("spawn")
    with safe_path_in_workers(), ProcessPoolExecutor(jobs, mp_context=context) as pool:
        trials = [
            pool.submit(perform, thing, mode, seed, recordings)
            for seed, thing, mode in product(seeds, things, modes)
        ]
        for trial in trials:
            yield trial.result()
