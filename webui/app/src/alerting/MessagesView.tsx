/** The log of what was sent about Alerts, what waits and what failed, newest first; older ones load on request. */
import { Inbox } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText, requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { RelativeTime } from "~/design/RelativeTime";
import { Select } from "~/design/Select";
import { StatusBadge, type Tone } from "~/design/StatusBadge";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { isoOf } from "~/devices/values";
import { useChoice } from "~/route/choice";
import { ROUTER, type MessageView } from "./api";

const REFRESH_MS = 5_000;
const PAGE = 100;
const STATES = ["waiting", "sent", "failed"] as const;
const tones: Record<string, Tone> = { waiting: "attention", sent: "ok", failed: "stop" };

export function MessagesView() {
  const { t } = useTranslation("alerting");
  const [state, setState] = useChoice("state", ["", ...STATES], "");
  return (
    <section className="alerting__wide" aria-label={t("view.sent")}>
      <div className="alerting__bar">
        <Select label={t("sent.state")} value={state} options={[{ value: "", name: t("sent.all") }, ...STATES.map((value) => ({ value, name: t(`sent.states.${value}`) }))]} onChange={setState} />
      </div>
      <Log key={state} state={state} />
    </section>
  );
}

function Log({ state }: { state: string }) {
  const { t } = useTranslation("alerting");
  const path = `messages?limit=${PAGE}${state === "" ? "" : `&state=${state}`}`;
  const { value, failure } = useServiceQuery<MessageView[]>(ROUTER, path, { intervalMs: REFRESH_MS });
  const [older, setOlder] = useState<readonly MessageView[]>([]);
  const [hasAll, setHasAll] = useState(false);
  const [refused, setRefused] = useState<string | null>(null);
  const [sorting, setSorting] = useSorting("-at", "sentSort");
  const rows = useMemo(() => {
    const newest = value ?? [];
    const numbers = new Set(newest.map(({ number }) => number));
    return [...newest, ...older.filter(({ number }) => !numbers.has(number))];
  }, [value, older]);
  const columns = useColumns();
  const load = async () => {
    setRefused(null);
    try {
      const page = await requestService<MessageView[]>(ROUTER, `${path}&before=${rows.at(-1)?.number ?? 0}`);
      setOlder((before) => [...before, ...page]);
      setHasAll(page.length < PAGE);
    } catch (error) {
      setRefused(errorText(error));
    }
  };
  const fault = refused ?? failure;
  return (
    <>
      {fault !== null && <ErrorMessage>{fault}</ErrorMessage>}
      {value !== null && rows.length === 0 && (
        <EmptyState icon={<Inbox aria-hidden size={32} />} title={t("sent.none")}>
          {t("sent.means")}
        </EmptyState>
      )}
      {rows.length > 0 && (
        <DataTable label={t("view.sent")} rows={rows} columns={columns} keyOf={({ number }) => String(number)} nameOf={({ subject }) => subject} rowHeight={64} isLabelled sorting={sorting} onSort={setSorting} view={state} />
      )}
      {rows.length >= PAGE && !hasAll && (
        <div className="alerting__acts">
          <Button onPress={() => void load()}>{t("sent.older")}</Button>
        </div>
      )}
    </>
  );
}

function useColumns(): readonly Column<MessageView>[] {
  const { t } = useTranslation("alerting");
  return useMemo(
    () => [
      {
        id: "subject", name: t("sent.subject"), width: "minmax(200px, 3fr)", sortBy: ({ subject }) => subject,
        cell: ({ subject, text, error }) => (
          <>
            <strong className="cell__name" title={text}>{subject}</strong>
            {error !== null && <p className="cell__detail" title={error}>{error}</p>}
          </>
        ),
      },
      { id: "channel", name: t("sent.channel"), width: "minmax(100px, 1fr)", sortBy: ({ channel }) => channel, cell: ({ channel }) => <span>{channel}</span> },
      {
        id: "route", name: t("sent.route"), width: "minmax(110px, 1fr)", sortBy: ({ route }) => route,
        cell: ({ route, step }) => <span>{route === "" ? t("sent.test") : `${route} · ${stepText((key, values) => t(key, values), step)}`}</span>,
      },
      { id: "at", name: t("sent.at"), width: "minmax(90px, 0.8fr)", isDescendingFirst: true, sortBy: ({ number }) => number, cell: ({ createdAt }) => <RelativeTime at={isoOf(createdAt)} /> },
      {
        id: "state", name: t("sent.state"), width: "minmax(130px, 1fr)", sortBy: ({ state }) => state,
        cell: ({ state, attempts }) => (
          <>
            <StatusBadge tone={tones[state] ?? "neutral"}>{t(`sent.states.${state}`, { defaultValue: state })}</StatusBadge>
            {attempts > 1 && <p className="cell__detail">{t("sent.attempts", { count: attempts })}</p>}
          </>
        ),
      },
    ],
    [t],
  );
}

function stepText(t: (key: string, values: Record<string, unknown>) => string, step: string): string {
  const [kind = step, number] = step.split("-");
  return t(`sent.steps.${kind}`, { defaultValue: step, number });
}
