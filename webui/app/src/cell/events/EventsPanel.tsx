/** The event log: a table with filter, older events on request, and export of all stored events. */
import { CircleX, Download, Info, ScrollText, TriangleAlert } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { eventsBefore } from "~/api/actions";
import { download } from "~/api/download";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { SegmentedControl } from "~/design/SegmentedControl";
import { EmptyState } from "~/design/EmptyState";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { ErrorMessage } from "~/design/ErrorMessage";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { exactTime } from "~/design/times";
import { useEvents } from "~/live/hooks";
import type { LiveEvent } from "~/live/messages";
import { useChoice } from "~/route/choice";
import { useQueryParameter } from "~/route/queryParameter";
import { allEvents, csv, type EventFilter, LEVELS, merged, MAX_SHOWN, passes, sourcesOf } from "./event_log";
import { useMessageText } from "./eventText";
import "./EventsPanel.css";

const PAGE = 200;
const EXPORT_PAGE = 1000;
const icons: Record<LiveEvent["level"], typeof Info> = { info: Info, attention: TriangleAlert, stop: CircleX };

export function EventsPanel() {
  const { t } = useTranslation("system");
  const textOf = useMessageText();
  const { filter, bar } = useFilter();
  const log = useLog();
  const [sorting, setSorting] = useSorting("-at");
  const columns = useColumns(textOf);
  const matching = useMemo(
    () => log.events.filter((event) => passes(event, filter, textOf(event))).reverse(),
    [log.events, filter, textOf],
  );
  return (
    <div className="events">
      {bar(log.sources)}
      <DataTable
        label={t("tab.events")}
        rows={matching}
        columns={columns}
        keyOf={keyOf}
        nameOf={textOf}
        rowHeight={37}
        sorting={sorting}
        onSort={setSorting}
        view={JSON.stringify(filter)}
      >
        {matching.length === 0 && (
          <EmptyState icon={<ScrollText aria-hidden size={32} />} title={t(log.events.length === 0 ? "events.none.title" : "events.noMatch.title")}>
            {t(log.events.length === 0 ? "events.none.means" : "events.noMatch.means")}
          </EmptyState>
        )}
        <div className="events__more">
          {log.failure !== null && <ErrorMessage>{log.failure}</ErrorMessage>}
          {log.isWhole ? (
            <p className="quiet">{t("events.whole")}</p>
          ) : log.events.length >= MAX_SHOWN ? (
            <p className="quiet">{t("events.most", { count: MAX_SHOWN })}</p>
          ) : (
            <Button isDisabled={log.busy} onPress={log.loadOlder}>
              {t("events.older")}
            </Button>
          )}
        </div>
      </DataTable>
      <Exports filter={filter} />
    </div>
  );
}

function keyOf(event: LiveEvent): string {
  return String(event.seq);
}

function useColumns(textOf: (event: LiveEvent) => string): readonly Column<LiveEvent>[] {
  const { t, i18n } = useTranslation(["system", "common"]);
  return useMemo(() => {
    const sourceOf = (event: LiveEvent) => t(`common:services.${event.source}`, { defaultValue: event.source });
    return [
      { id: "at", name: t("events.column.at"), width: "148px", isDescendingFirst: true, sortBy: (event) => Date.parse(event.at), cell: (event) => <EventTime at={event.at} language={i18n.language} /> },
      {
        id: "level", name: t("events.levels"), width: "112px", isDescendingFirst: true, sortBy: (event) => LEVELS.indexOf(event.level),
        cell: (event) => {
          const Icon = icons[event.level];
          return (
            <span className="event__level" data-level={event.level}>
              <Icon aria-hidden size={16} />
              <span>{t(`events.eventLevel.${event.level}`)}</span>
            </span>
          );
        },
      },
      { id: "source", name: t("events.source"), width: "minmax(120px, 190px)", sortBy: sourceOf, cell: (event) => <span className="quiet">{sourceOf(event)}</span> },
      { id: "text", name: t("events.column.text"), width: "minmax(240px, 1fr)", cell: textOf },
    ];
  }, [t, i18n.language, textOf]);
}

function EventTime({ at, language }: { at: string; language: string }) {
  const time = new Date(at);
  const isToday = time.toDateString() === new Date().toDateString();
  return (
    <time className="event__time" dateTime={at} title={exactTime(at, language)}>
      {!isToday && <span className="event__day">{time.toLocaleDateString(language, { day: "numeric", month: "short" })}</span>}{" "}
      {time.toLocaleTimeString(language, { timeStyle: "medium", hourCycle: "h23" })}
    </time>
  );
}

/** The events received live, and the older ones that were requested. */
function useLog() {
  const live = useEvents();
  const [received, setReceived] = useState(live);
  const [events, setEvents] = useState(() => merged([], live));
  const [isWhole, setIsWhole] = useState(false);
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  if (live !== received) {
    setReceived(live);
    setEvents(merged(events, live));
  }
  const loadOlder = () => {
    setBusy(true);
    setFailure(null);
    eventsBefore(events[0]?.seq ?? Number.MAX_SAFE_INTEGER, PAGE)
      .then((older) => {
        setEvents((current) => merged(current, older));
        setIsWhole(older.length < PAGE);
      })
      .catch((error: unknown) => setFailure(errorText(error)))
      .finally(() => setBusy(false));
  };
  const sources = useMemo(() => sourcesOf(events), [events]);
  return { events, sources, isWhole, busy, failure, loadOlder };
}

const CHOICES = ["", "attention", "stop"] as const;

/** The filter, stored in the URL, and the bar that sets it. */
function useFilter() {
  const { t } = useTranslation(["system", "common"]);
  const [level, setLevel] = useChoice("level", CHOICES, "");
  const [source, setSource] = useQueryParameter("source");
  const [text, setText] = useQueryParameter("text");
  const filter: EventFilter = useMemo(
    () => ({ level, source, text }),
    [level, source, text],
  );
  const levels = CHOICES.map((value) => ({ value, name: t(`events.level.${value || "all"}`) }));
  const bar = (sources: readonly string[]) => {
    const options = [
      { value: "", name: t("events.allSources") },
      ...[...new Set([...sources, ...(source === "" ? [] : [source])])].map((name) => ({
        value: name,
        name: t(`common:services.${name}`, { defaultValue: name }),
      })),
    ];
    return (
      <div className="events__filter">
        <SegmentedControl label={t("events.levels")} value={filter.level} options={levels} onChange={setLevel} />
        <Select label={t("events.source")} value={source} options={options} onChange={setSource} />
        <Field label={t("events.text")} value={text} onChange={setText} type="search" />
      </div>
    );
  };
  return { filter, bar };
}

/** Exports all stored events that match the filter, not only the loaded ones. */
function Exports({ filter }: { filter: EventFilter }) {
  const { t } = useTranslation("system");
  const textOf = useMessageText();
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const take = (kind: "csv" | "json") => {
    setBusy(true);
    setFailure(null);
    void allEvents((before) => eventsBefore(before, EXPORT_PAGE))
      .then((all) => {
        const events = all.filter((event) => passes(event, filter, textOf(event)));
        const name = `handover-events-${new Date().toISOString().slice(0, 10)}.${kind}`;
        if (kind === "csv") download(name, "text/csv;charset=utf-8", csv(events));
        else download(name, "application/json", `${JSON.stringify(events, null, 2)}\n`);
      })
      .catch((error: unknown) => setFailure(errorText(error)))
      .finally(() => setBusy(false));
  };
  return (
    <div className="events__export">
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {(["csv", "json"] as const).map((kind) => (
        <Button key={kind} isDisabled={busy} icon={<Download aria-hidden size={16} />} onPress={() => take(kind)}>
          {t(`events.export.${kind}`)}
        </Button>
      ))}
    </div>
  );
}
