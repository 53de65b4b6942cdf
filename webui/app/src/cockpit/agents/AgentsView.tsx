/** Agents: who can perform Tasks, with skills, load, shift and place, and what they do now. */
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { AgentView } from "~/api/generated/task-orchestrator";
import { useServiceQuery } from "~/api/useServiceQuery";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { number } from "~/design/numbers";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { localizedText } from "~/i18n/server";
import { shortName } from "~/live/urn";
import { pathOf } from "~/processes/address";
import { useQueryParameter } from "~/route/queryParameter";
import { isFound, loadOf, shiftsOf, standingOf, STANDING_TONES } from "./agents";

const REFRESH_MS = 5000;

export function useAgents() {
  return useServiceQuery<AgentView[]>("task-orchestrator", "agents", { intervalMs: REFRESH_MS });
}

export function AgentsView() {
  const { t } = useTranslation("cockpit");
  const { value, failure } = useAgents();
  const [find, setFind] = useQueryParameter("agent");
  const [sorting, setSorting] = useSorting("-load", "agentSort");
  const columns = useColumns();
  const rows = useMemo(() => (value ?? []).filter((agent) => isFound(agent, find)), [value, find]);
  if (value?.length === 0) return <EmptyState title={t("agents.none")}>{t("agents.noneHow")}</EmptyState>;
  return (
    <section className="cockpit__section" aria-label={t("view.agents")}>
      {failure !== null && <ErrorMessage>{t("unread", { why: failure })}</ErrorMessage>}
      <div className="cockpit__bar">
        <Field label={t("agents.find")} type="search" value={find} onChange={setFind} />
      </div>
      <DataTable
        label={t("view.agents")}
        rows={rows}
        columns={columns}
        keyOf={(agent) => agent.id}
        nameOf={(agent) => shortName(agent.id)}
        rowHeight={64}
        isLabelled
        view={find}
        sorting={sorting}
        onSort={setSorting}
      />
    </section>
  );
}

function useColumns(): readonly Column<AgentView>[] {
  const { t, i18n } = useTranslation(["cockpit", "common"]);
  return useMemo(
    () => [
      {
        id: "name", name: t("agents.name"), width: "minmax(120px, 1.2fr)", sortBy: (agent) => shortName(agent.id),
        cell: (agent) => (
          <>
            <span className="cell__name">{shortName(agent.id)}</span>
            <p className="cell__detail">{t(agent.isPerson ? "agents.person" : "agents.device")}</p>
          </>
        ),
      },
      {
        id: "state", name: t("agents.state"), width: "minmax(164px, 1.1fr)", sortBy: standingOf,
        cell: (agent) => (
          <>
            <StatusBadge tone={STANDING_TONES[standingOf(agent)]}>{t(`agents.standing.${standingOf(agent)}`)}</StatusBadge>
            {agent.unavailable !== null && <p className="cell__detail">{t(`agents.reason.${agent.unavailable}`, { defaultValue: agent.unavailable })}</p>}
          </>
        ),
      },
      {
        id: "skills", name: t("agents.skills"), width: "minmax(150px, 1.8fr)", sortBy: (agent) => Object.keys(agent.skills).length,
        cell: (agent) => (
          <span>
            {[...agent.roles, ...Object.entries(agent.skills).map(([name, { level }]) => (level === 1 ? name : t("agents.level", { name, level: number(level, i18n.language) })))].join(", ") || "–"}
          </span>
        ),
      },
      {
        id: "load", name: t("agents.load"), width: "minmax(80px, 0.7fr)", isNumber: true, isDescendingFirst: true, sortBy: loadOf,
        cell: (agent) => <span>{agent.capacity === null ? agent.tasks.length : t("agents.ofCapacity", { load: agent.tasks.length, capacity: agent.capacity })}</span>,
      },
      {
        id: "tasks", name: t("agents.now"), width: "minmax(200px, 2.6fr)",
        cell: (agent) => (
          <>
            {agent.tasks.slice(0, 3).map((task) => (
              <div key={task.id} className="cockpit__task">
                <Link href={pathOf({ kind: "process", id: task.process })} tabIndex={-1}>
                  {task.name}
                </Link>{" "}
                <span className="quiet small">
                  {t(`common:status.${task.status}`)} · <RelativeTime at={task.since} />
                </span>
                {task.allocated !== null && <p className="cell__detail">{localizedText(task, "allocated")}</p>}
              </div>
            ))}
            {agent.tasks.length > 3 && <p className="cell__detail">{t("agents.more", { count: agent.tasks.length - 3 })}</p>}
            {agent.tasks.length === 0 && <span>–</span>}
          </>
        ),
      },
      { id: "shifts", name: t("agents.shifts"), width: "minmax(130px, 1.3fr)", cell: (agent) => <span>{shiftsOf(agent, i18n.language) || t("agents.always")}</span> },
      {
        id: "place", name: t("agents.place"), width: "minmax(90px, 0.9fr)",
        cell: (agent) => <span>{agent.position === null ? "–" : `${agent.position.map((value) => number(value, i18n.language)).join(" · ")} ${agent.isGeographic ? "°" : "m"}`}</span>,
      },
    ],
    [t, i18n.language],
  );
}
