"""`handover case`: a case of the body as a sensor, with simulated person and machine, from one command."""

import asyncio
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Protocol

import httpx

from handover.command_line.access import AccessAuth, cli_access
from handover.errors import UsageError
from handover.extensions import ExtensionPoint, Service
from handover.network.tls_trust import client_context
from handover.service_addresses import ASSISTIVE_DEVICES, BROKER, HUMAN_STATE
from handover.services import has_own_broker, service_named
from handover.settings import Settings
from handover_cases.machine import CASES, Case
from handover_cases.trial import Trial
from handover_cell.launching.launcher import Launcher
from handover_cell.progress import Say

PURPOSES = ["live", "speedLimits", "history", "broker"]
CONSENT = timedelta(days=1)
QUERY_EVERY_S = 0.3
CASE_STUDIES = ExtensionPoint(
    "study of a case", "handover.case_studies", {"treadmill": "handover_cell.cases.treadmill:perform_study"}
)
"""A `Study` each."""
COLUMNS = ("figure", "paper", "here", "")


class Study(Protocol):
    """Performs the trial of a case on a clock of its own, faster than life."""

    def __call__(self, duration_s: float | None, say: Say, *, consents_to_model: bool) -> Trial:
        """Take the seconds of a session, None for those of the paper, and say what happens."""
        ...


@dataclass(frozen=True, slots=True)
class TrialWish:
    """How a trial is to be: seconds, None for those of the paper, and a consent of its simulated person."""

    duration_s: float | None = None
    consents_to_model: bool = False


def load_case(name: str) -> Case:
    """Return the case `name` with its settings in the environment; raise `UsageError` with the known ones."""
    case: Case = CASES.load(name)
    os.environ["HANDOVER_ASSISTIVE_MACHINES"] = name
    return case


def study_of(name: str) -> Study | None:
    """Return what performs the trial of a case on a clock of its own, faster than life; None without one."""
    return CASE_STUDIES.load(name) if name in CASE_STUDIES.names() else None


def print_study(name: str, trial: Trial, say: Say) -> None:
    """Print the figures of a study. Raises `UsageError` if the machine did not do what it should."""
    for line in table([asdict(figure) for figure in trial.figures]):
        say(line)
    if not trial.passed:
        wrong = [figure.name for figure in trial.figures if figure.passed is False]
        raise UsageError(f"the case {name} failed: not as it should be: {', '.join(wrong)}")


def known_cases() -> list[Case]:
    """Return all cases, ours first."""
    return [CASES.load(name) for name in CASES.names()]


def services_of(case: Case) -> tuple[Service, ...]:
    """Return the services that a case needs."""
    broker = (BROKER,) if has_own_broker() else ()
    names = dict.fromkeys((*broker, *case.services, "webui"))
    return tuple(map(service_named, (*names, HUMAN_STATE, ASSISTIVE_DEVICES)))


async def run_case(
    case: Case, settings: Settings, wish: TrialWish, *, once: bool, timeout_s: float, say: Say
) -> None:
    """Start what the case needs, add its person, perform its trial, print the figures.

    Runs until stopped unless `once`. Raises `UsageError` if the machine did not do what it should.
    """
    services = services_of(case)
    async with Launcher(services, settings, say), cli_access(settings) as access:
        say(f"{', '.join(service.name for service in services)}: ready")
        say(f"Look at it on {service_named('webui').url()}/cases?case={case.name}")
        async with httpx.AsyncClient(
            trust_env=False, verify=client_context(*settings.ca_files), auth=AccessAuth(access), timeout=30
        ) as http:
            await add_person(http, case)
            machine = f"{service_named(ASSISTIVE_DEVICES).url()}/machines/{case.name}"
            body = {"durationS": wish.duration_s, "consentsToModel": wish.consents_to_model}
            await _ask(http, "POST", f"{machine}/trial", body)
            try:
                async with asyncio.timeout(timeout_s):
                    trial = await _follow(http, machine, say)
            except TimeoutError:
                raise UsageError(
                    f"the trial did not end within {timeout_s:.0f} s; see the logs in "
                    f"{settings.data_dir / 'logs'}"
                ) from None
        for line in table(trial["figures"]):
            say(line)
        if not trial["passed"]:
            wrong = [figure["name"] for figure in trial["figures"] if figure["passed"] is False]
            reason = trial["failure"] or f"not as it should be: {', '.join(wrong)}"
            raise UsageError(f"the case {case.name} failed: {reason}")
        if not once:
            say("Everything keeps running; Ctrl-C stops it. The page starts further trials.")
            await asyncio.Event().wait()


async def add_person(http: httpx.AsyncClient, case: Case) -> None:
    """Add the simulated person of a case to human state, who consents for a day, and bind the machine."""
    base, person = service_named(HUMAN_STATE).url(), case.person
    await _ask(http, "PUT", f"{base}/people/{person}", dict(case.person_settings))
    consent = {
        "purposes": PURPOSES,
        "ends": (datetime.now(UTC) + CONSENT).isoformat(),
        "givenBy": "a simulated person",
    }
    await _ask(http, "PUT", f"{base}/people/{person}/consent", consent)
    for kind in case.sensors:
        sensor = {"person": person, "driver": "simulated", "settings": dict(kind.settings)}
        await _ask(http, "PUT", f"{base}/sensors/{kind.name}", sensor)
    await _ask(http, "PUT", f"{base}/people/{person}/robots/{case.robot}")


async def _follow(http: httpx.AsyncClient, machine: str, say: Say) -> dict[str, Any]:
    """Print what happens until the trial has ended; return it."""
    shown_s = -1.0
    while True:
        trial: dict[str, Any] = (await _ask(http, "GET", machine))["trial"]
        for text in trial["messages"]:
            if text["atS"] > shown_s:
                shown_s = text["atS"]
                say(f"{shown_s:6.1f} s  {text['text']}")
        if not trial["isRunning"]:
            return trial
        await asyncio.sleep(QUERY_EVERY_S)


async def _ask(http: httpx.AsyncClient, method: str, url: str, body: Any = None) -> Any:
    answer = await http.request(method, url, json=body)
    if not answer.is_success:
        raise UsageError(f"{method} {url} answered {answer.status_code}: {answer.text[:300]}")
    return answer.json()


def table(figures: Sequence[dict[str, Any]]) -> list[str]:
    """Return the figures of the paper beside ours, as lines."""
    marks = {True: "ok", False: "FAILED", None: ""}
    rows = [(figure["name"], figure["paper"], figure["ours"], marks[figure["passed"]]) for figure in figures]
    widths = [max(len(row[column]) for row in (COLUMNS, *rows)) for column in range(len(COLUMNS))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in (COLUMNS, *rows)
    ]
