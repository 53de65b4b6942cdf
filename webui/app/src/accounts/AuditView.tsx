/** Audit: who changed what, and who read data of persons, in all services; filters, export, verification. */
import { Download, ScrollText, ShieldCheck } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { download } from "~/api/download";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { StatusBadge } from "~/design/StatusBadge";
import type { Tone } from "~/design/StatusBadge";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { exactTime } from "~/design/times";
import { useTopicSelector } from "~/live/hooks";
import { useQueryParameter } from "~/route/queryParameter";
import { mayDo, useSession } from "~/session/session";
import { resourceName, SERVICE, useUsers, type TokenView } from "./accounts";
import { actionText, AUDITED, exported, outcomeOf, OUTCOMES, servicesOf, unnamedKind, useAudit, verified, type AuditFilter, type AuditView as Entry, type Failure, type Verified } from "./audit";

const TONES: Record<string, Tone> = { done: "ok", refused: "attention", failed: "stop", unknown: "attention" };
const FORMATS = ["csv", "json"] as const;

export function AuditLogView() {
  const { t } = useTranslation(["accounts", "common"]);
  const [filter, bar] = useFilter();
  const names = useNames();
  const running = useTopicSelector("services", (known) => (known ?? []).map(({ name }) => name).join());
  const services = servicesOf(filter, running.split(","));
  const { records, failures, loadOlder } = useAudit(filter, services);
  const [sorting, setSorting] = useSorting("-when", "auditSort");
  const columns = useColumns(names);
  const [fault, setFault] = useState<string | null>(null);
  const [missing, setMissing] = useState<readonly Failure[]>([]);
  const [checks, setChecks] = useState<readonly Verified[] | null>(null);
  const [busy, setBusy] = useState(false);
  const perform = async (action: () => Promise<void>) => {
    setBusy(true);
    setFault(null);
    setMissing([]);
    try {
      await action();
    } catch (error) {
      setFault(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  return (
    <section className="accounts__wide" aria-label={t("audit.title")}>
      <div className="accounts__bar" role="group" aria-label={t("audit.title")}>
        <FilterFields filter={filter} bar={bar} names={names} />
      </div>
      <div className="accounts__bar">
        {FORMATS.map((format) => (
          <Button
            key={format}
            icon={<Download aria-hidden size={18} />}
            isDisabled={busy}
            onPress={() =>
              void perform(async () => {
                const file = await exported(filter, services, format, names);
                download(file.name, format === "csv" ? "text/csv" : "application/json", file.text);
                setMissing(file.missing);
              })
            }
          >
            {t("audit.export", { format: format.toUpperCase() })}
          </Button>
        ))}
        <Button icon={<ShieldCheck aria-hidden size={18} />} isDisabled={busy} onPress={() => void perform(async () => setChecks(await verified(services)))}>
          {t("audit.verify")}
        </Button>
      </div>
      {fault !== null && <ErrorMessage>{fault}</ErrorMessage>}
      {missing.length > 0 && (
        <ErrorMessage>{t("audit.exportLacks", { services: missing.map(({ service, failure }) => t("audit.unread", { service: t(`common:services.${service}`), why: failure })).join(" ") })}</ErrorMessage>
      )}
      {failures.length > 0 && (
        <ErrorMessage>{failures.map(({ service, failure }) => t("audit.unread", { service: t(`common:services.${service}`), why: failure })).join(" ")}</ErrorMessage>
      )}
      {checks !== null && <Checks checks={checks} />}
      <DataTable
        label={t("audit.title")}
        rows={records ?? []}
        columns={columns}
        keyOf={({ service, seq }) => `${service} ${seq}`}
        nameOf={({ action, subject, subjectName }) => `${actionText(t, action)}, ${subjectName ?? names.get(subject) ?? t(`audit.unnamed.${unnamedKind(subject)}`)}`}
        rowHeight={52}
        isLabelled
        sorting={sorting}
        onSort={setSorting}
        view={JSON.stringify(filter)}
        onEnd={loadOlder}
      >
        {records?.length === 0 && (
          <EmptyState icon={<ScrollText aria-hidden size={24} />} title={t("audit.none")}>
            {t("audit.noneMeans")}
          </EmptyState>
        )}
      </DataTable>
    </section>
  );
}

function Checks({ checks }: { checks: readonly Verified[] }) {
  const { t } = useTranslation(["accounts", "common"]);
  return (
    <Card title={t("audit.verified")}>
      <ul className="accounts__rows" role="status">
        {checks.map(({ service, result, failure }) => {
          const name = t(`common:services.${service}`);
          const isIntact = result !== null && result.fault === null;
          return (
            <li key={service}>
              <StatusBadge tone={isIntact ? "ok" : result === null ? "attention" : "stop"}>
                {isIntact
                  ? t("audit.intact", { service: name, count: result.records, head: result.head.slice(0, 16) })
                  : result === null
                    ? t("audit.unread", { service: name, why: failure ?? "" })
                    : t("audit.damaged", { service: name, fault: result.fault ?? "" })}
              </StatusBadge>
              {result !== null && result.withoutOutcome.length > 0 && (
                <p className="cell__detail">{t("audit.withoutOutcome", { count: result.withoutOutcome.length, numbers: result.withoutOutcome.slice(0, 20).join(", ") })}</p>
              )}
            </li>
          );
        })}
      </ul>
    </Card>
  );
}

type Bar = Record<keyof AuditFilter, (value: string) => void>;

/** The filter in the address of the page. */
function useFilter(): [AuditFilter, Bar] {
  const [service, setService] = useQueryParameter("service");
  const [subject, setSubject] = useQueryParameter("who");
  const [action, setAction] = useQueryParameter("action");
  const [resource, setResource] = useQueryParameter("resource");
  const [outcome, setOutcome] = useQueryParameter("outcome");
  const [from, setFrom] = useQueryParameter("from");
  const [to, setTo] = useQueryParameter("to");
  return [
    { service, subject, action, resource, outcome, from, to },
    { service: setService, subject: setSubject, action: setAction, resource: setResource, outcome: setOutcome, from: setFrom, to: setTo },
  ];
}

function FilterFields({ filter, bar, names }: { filter: AuditFilter; bar: Bar; names: ReadonlyMap<string, string> }) {
  const { t } = useTranslation(["accounts", "common"]);
  const people = [...names].map(([value, name]) => ({ value, name })).sort((a, b) => a.name.localeCompare(b.name));
  return (
    <>
      <Select
        label={t("audit.service")}
        value={filter.service}
        options={[{ value: "", name: t("audit.allServices") }, ...AUDITED.map((value) => ({ value, name: t(`common:services.${value}`) }))]}
        onChange={bar.service}
      />
      <Select label={t("audit.person")} value={filter.subject} options={[{ value: "", name: t("audit.anybody") }, ...people]} onChange={bar.subject} />
      <Field label={t("audit.action")} type="search" value={filter.action} onChange={bar.action} maxLength={64} />
      <Field label={t("audit.resource")} type="search" value={filter.resource} onChange={bar.resource} maxLength={300} />
      <Select
        label={t("audit.outcome")}
        value={filter.outcome}
        options={[{ value: "", name: t("audit.allOutcomes") }, ...OUTCOMES.map((value) => ({ value, name: t(`audit.outcomes.${value}`) }))]}
        onChange={bar.outcome}
      />
      <Field label={t("audit.from")} type="date" value={filter.from} onChange={bar.from} />
      <Field label={t("audit.to")} type="date" value={filter.to} onChange={bar.to} />
    </>
  );
}

/** The names of subjects: users, tokens, and what acts without an account. */
function useNames(): ReadonlyMap<string, string> {
  const { t } = useTranslation("accounts");
  const mayList = useSession().hasAccounts && mayDo("managePeople");
  const { users } = useUsers(mayList);
  const tokens = useServiceQuery<TokenView[]>(SERVICE, mayList ? "tokens" : null).value;
  return useMemo(
    () =>
      new Map([
        ["local", t("audit.local")],
        ["command-line", t("audit.commandLine")],
        ...(users ?? []).map(({ subject, name }) => [subject, name] as const),
        ...(tokens ?? []).map(({ subject, name }) => [subject, name] as const),
      ]),
    [users, tokens, t],
  );
}

function useColumns(names: ReadonlyMap<string, string>): readonly Column<Entry>[] {
  const { t, i18n } = useTranslation(["accounts", "common"]);
  return useMemo(
    () => [
      { id: "when", name: t("audit.when"), width: "minmax(150px, 1fr)", isDescendingFirst: true, sortBy: ({ at }) => at, cell: ({ at }) => <time dateTime={at}>{exactTime(at, i18n.language)}</time> },
      {
        id: "who", name: t("audit.who"), width: "minmax(120px, 1.2fr)", sortBy: ({ subject }) => names.get(subject) ?? subject,
        cell: ({ subject, subjectName }) => (
          <>
            <span className="cell__name">{subjectName ?? names.get(subject) ?? t(`audit.unnamed.${unnamedKind(subject)}`)}</span>
            <p className="cell__detail accounts__subject" title={subject}>{subject}</p>
          </>
        ),
      },
      {
        id: "what", name: t("audit.what"), width: "minmax(180px, 2fr)", sortBy: ({ action }) => action,
        cell: ({ action, service }) => (
          <>
            <span className="accounts__action" title={action}>{actionText(t, action)}</span>
            <p className="cell__detail">{t(`common:services.${service}`, { defaultValue: service })}</p>
          </>
        ),
      },
      {
        id: "on", name: t("audit.on"), width: "minmax(120px, 1.4fr)", sortBy: ({ resource }) => resource,
        cell: ({ resource, resourceName: name }) => <span title={resource}>{name ?? names.get(resource) ?? (resource === "*" ? t("grants.everything") : resourceName(resource))}</span>,
      },
      {
        id: "outcome", name: t("audit.outcome"), width: "minmax(110px, 0.8fr)", sortBy: ({ outcome }) => outcome,
        cell: (entry) => {
          const outcome = outcomeOf(entry);
          return <StatusBadge tone={TONES[outcome] ?? "neutral"}>{t(`audit.outcomes.${outcome}`, { defaultValue: outcome })}</StatusBadge>;
        },
      },
      { id: "details", name: t("audit.details"), width: "minmax(140px, 2fr)", cell: ({ text }) => <span className="quiet small accounts__action">{text ?? ""}</span> },
    ],
    [t, i18n.language, names],
  );
}
