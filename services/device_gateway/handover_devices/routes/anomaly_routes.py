"""REST of anomalies: rules, what they find now, and what they would have found."""

import asyncio
import time
from typing import Annotated, Final

from fastapi import FastAPI, Query
from pydantic import ConfigDict, Field
from sqlalchemy import Engine
from typing_extensions import TypedDict

from handover.alerts import alert_id
from handover.errors import Problem
from handover.formats.strict_json import StrictModel
from handover.http.body_limit import max_body
from handover.security.guard import require
from handover.security.permissions import Permission
from handover.settings import Settings
from handover_datamodels.entities import Severity
from handover_devices.anomalies.anomalies import Anomalies
from handover_devices.anomalies.backtest import Finding, findings
from handover_devices.anomalies.baseline import baseline_of
from handover_devices.anomalies.delivery import alert_key
from handover_devices.anomalies.monitor import Watch
from handover_devices.anomalies.rules import MAX_RULES, Rule, SeasonalCheck, is_rule_name
from handover_devices.gateway import DeviceGateway
from handover_devices.storage import anomaly_store, history

MAX_RULE_BYTES: Final = 64 * 1024
MAX_SAMPLES: Final = 200_000
DAY_S: Final = 86_400.0


class RuleView(TypedDict):
    """A rule; one whose `source` is `file` is changed in the file of HANDOVER_DEVICE_RULES."""

    name: str
    source: str
    rule: Rule


class AnomalyView(TypedDict):
    """What a rule has found for one value; `since` is when it became abnormal, or normal again."""

    rule: str
    device: str
    value: str
    active: bool
    since: float | None
    measured: float | None
    limit: float | None
    severity: Severity
    alert: str
    processStartedAt: float | None


class RuleTest(StrictModel):
    """A rule to apply to the history of one value; without times that of the last 24 hours."""

    model_config = ConfigDict(extra="forbid")

    rule: Rule
    device: str
    value: str
    begin: float | None = Field(None, ge=0, le=1e11)
    end: float | None = Field(None, ge=0, le=1e11)


class FindingView(TypedDict):
    """An Alert that the rule would have raised."""

    begin: float
    end: float | None
    measured: float
    limit: float


class RuleTestView(TypedDict):
    """What a rule would have found in so many values."""

    values: int
    findings: list[FindingView]


def add_anomaly_routes(
    app: FastAPI,
    settings: Settings,
    gateway: DeviceGateway,
    engine: Engine,
    anomalies: Anomalies,
) -> None:
    """Add the routes of anomalies."""
    monitor, in_file = anomalies.monitor, anomalies.in_file
    can_read = require(Permission.READ)
    # A rule may start a process, so who writes one needs the permission for that, too.
    can_write = [require(Permission.CONFIGURE), require(Permission.RUN_PROCESSES)]

    def view(name: str, rule: Rule) -> RuleView:
        return {"name": name, "source": "file" if name in in_file else "rest", "rule": rule}

    def rule_named(name: str) -> Rule:
        rule = monitor.rules.get(name)
        if rule is None:
            raise Problem.translated(
                404,
                "No such rule",
                "device.rule_unknown",
                'there is no rule "{rule}"; GET /rules lists them',
                rule=name[:64],
            )
        return rule

    def require_writable(name: str) -> None:
        if name in in_file:
            raise Problem.translated(
                409,
                "Rule of a file",
                "device.rule_in_file",
                'the rule "{rule}" is in the file of HANDOVER_DEVICE_RULES; change it there and restart '
                "the device gateway, or choose another name",
                rule=name,
            )

    @app.get("/rules", tags=["anomalies"], dependencies=[can_read])
    async def rules() -> list[RuleView]:
        """List the rules by name."""
        return [view(name, rule) for name, rule in sorted(monitor.rules.items())]

    @app.get("/rules/{name}", tags=["anomalies"], dependencies=[can_read])
    async def rule(name: str) -> RuleView:
        """Return a rule."""
        return view(name, rule_named(name))

    @app.put("/rules/{name}", tags=["anomalies"], dependencies=can_write)
    @max_body(MAX_RULE_BYTES)
    async def save(name: str, rule: Rule) -> RuleView:
        """Add or replace a rule; a replaced rule begins without a past, and its Alerts are cleared."""
        require_writable(name)
        if not is_rule_name(name):
            raise Problem.translated(
                422,
                "Not a name",
                "device.rule_bad_name",
                '"{rule}" cannot be the name of a rule: 1 to 64 letters, digits, "_", "." or "-", '
                "a letter or digit first",
                rule=name[:64],
            )
        if name not in monitor.rules and len(monitor.rules) >= MAX_RULES:
            raise Problem.translated(
                409,
                "Too many rules",
                "device.rules_too_many",
                "there are {maximum} rules, the maximum; delete one, or use patterns for devices",
                maximum=MAX_RULES,
            )
        text = rule.model_dump_json(by_alias=True, exclude_defaults=False)
        now_us = int(time.time() * 1e6)
        await gateway.writer.call(lambda connection: anomaly_store.save_rule(connection, name, text, now_us))
        monitor.set_rule(name, rule)
        return view(name, rule)

    @app.delete("/rules/{name}", status_code=204, tags=["anomalies"], dependencies=can_write)
    async def remove(name: str) -> None:
        """Delete a rule; its Alerts are cleared."""
        require_writable(name)
        rule_named(name)
        await gateway.writer.call(lambda connection: anomaly_store.save_rule(connection, name, None, 0))
        monitor.set_rule(name, None)

    @app.get("/anomalies", tags=["anomalies"], dependencies=[can_read])
    async def list_anomalies(
        all: Annotated[bool, Query(description="also what is normal")] = False,  # noqa: A002 - the parameter
        device: str | None = None,
    ) -> list[AnomalyView]:
        """List what the rules find abnormal now."""
        return [
            _anomaly(settings, watch)
            for watch in monitor.watches.values()
            if (all or watch.alarm.is_on) and device in {None, watch.key.device}
        ]

    @app.post("/rules/test", tags=["anomalies"], dependencies=[can_read])
    @max_body(MAX_RULE_BYTES)
    async def test(test: RuleTest) -> RuleTestView:
        """Return what a rule would have found in the history; nothing is changed."""
        gateway.device(test.device)
        end = time.time() if test.end is None else test.end
        begin = end - DAY_S if test.begin is None else test.begin

        def read() -> RuleTestView:
            series = history.series_of(engine, test.device).get(test.value)
            if series is None:
                return {"values": 0, "findings": []}
            samples = history.samples(engine, series, int(begin * 1e6), int(end * 1e6), MAX_SAMPLES)
            check = test.rule.check
            baseline = baseline_of(engine, series, check, begin) if isinstance(check, SeasonalCheck) else None
            matches = findings(test.rule, samples, end, baseline)
            return {"values": len(samples), "findings": [_finding(finding) for finding in matches]}

        return await asyncio.to_thread(read)


def _finding(finding: Finding) -> FindingView:
    return {"begin": finding.begin, "end": finding.end, "measured": finding.measured, "limit": finding.limit}


def _anomaly(settings: Settings, watch: Watch) -> AnomalyView:
    is_known = watch.changed_at > 0
    return {
        "rule": watch.key.rule,
        "device": watch.key.device,
        "value": watch.key.value,
        "active": watch.alarm.is_on,
        "since": watch.changed_at if is_known else None,
        "measured": watch.measured if is_known else None,
        "limit": watch.limit if is_known else None,
        "severity": watch.rule.severity,
        "alert": alert_id(settings, alert_key(watch.key)),
        "processStartedAt": watch.process_at,
    }
