/** The event log: live, filtered, back to the oldest that is kept, and never moving under the reader's eyes. */
import { ArrowUp, Download, ScrollText } from "lucide-react";
import { useMemo, useRef, useState } from "react";
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
import { useEvents } from "~/live/hooks";
import { useQueryParameter } from "~/route/queryParameter";
import { allEvents, csv, type EventFilter, gathered, held, MAX_SHOWN, passes, sourcesOf } from "./event_log";
import { EventRow } from "./EventRow";
import { useMessageText } from "./eventText";
import "./EventsPanel.css";

const PAGE = 200;
const EXPORT_PAGE = 1000;
/** So near to its top a list is still looked at from the top. */
const TOP_TOLERANCE_PX = 8;

export function EventsPanel() {
  const { t } = useTranslation("system");
  const said = useMessageText();
  const { filter, bar } = useFilter();
  const log = useLog();
  const [upTo, setUpTo] = useState<number | null>(null);
  const list = useRef<HTMLOListElement>(null);

  const passing = useMemo(
    () => log.events.filter((event) => passes(event, filter, said(event))),
    [log.events, filter, said],
  );
  const { shown, waiting } = held(passing, upTo);

  const onScroll = (top: number) => {
    if (top <= TOP_TOLERANCE_PX) setUpTo(null);
    else setUpTo((place) => place ?? log.events.at(-1)?.seq ?? null);
  };
  const toNewest = () => {
    setUpTo(null);
    list.current?.scrollTo({ top: 0 });
    list.current?.focus();
  };
  return (
    <div className="events">
      {bar(log.sources)}
      <div className="events__frame">
        {waiting > 0 && (
          <div className="events__new">
            <Button kind="main" icon={<ArrowUp aria-hidden size={16} />} onPress={toNewest}>
              {t("events.new", { count: waiting })}
            </Button>
          </div>
        )}
        <ol
          ref={list}
          className="events__list"
          aria-label={t("tab.events")}
          tabIndex={0}
          onScroll={(event) => onScroll(event.currentTarget.scrollTop)}
        >
          {shown.map((event) => (
            <EventRow key={event.seq} event={event} said={said(event)} />
          ))}
          {shown.length === 0 && (
            <li>
              <EmptyState icon={<ScrollText aria-hidden size={32} />} title={t(log.events.length === 0 ? "events.none.title" : "events.noMatch.title")}>
                {t(log.events.length === 0 ? "events.none.means" : "events.noMatch.means")}
              </EmptyState>
            </li>
          )}
          <li className="events__more">
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
          </li>
        </ol>
      </div>
      <Exports filter={filter} />
    </div>
  );
}

/** The events that the page knows: those that came live, and the older ones that were asked for. */
function useLog() {
  const live = useEvents();
  const [taken, setTaken] = useState(live);
  const [events, setEvents] = useState(() => gathered([], live));
  const [isWhole, setIsWhole] = useState(false);
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  if (live !== taken) {
    setTaken(live);
    setEvents(gathered(events, live));
  }
  const loadOlder = () => {
    setBusy(true);
    setFailure(null);
    eventsBefore(events[0]?.seq ?? Number.MAX_SAFE_INTEGER, PAGE)
      .then((older) => {
        setEvents((known) => gathered(known, older));
        setIsWhole(older.length < PAGE);
      })
      .catch((error: unknown) => setFailure(errorText(error)))
      .finally(() => setBusy(false));
  };
  const sources = useMemo(() => sourcesOf(events), [events]);
  return { events, sources, isWhole, busy, failure, loadOlder };
}

/** The filter, which the URL holds, and the bar that sets it. */
function useFilter() {
  const { t } = useTranslation(["system", "common"]);
  const [level, setLevel] = useQueryParameter("level");
  const [source, setSource] = useQueryParameter("source");
  const [text, setText] = useQueryParameter("text");
  const filter: EventFilter = useMemo(
    () => ({ level: level === "attention" || level === "stop" ? level : "", source, text }),
    [level, source, text],
  );
  const levels = (["", "attention", "stop"] as const).map((value) => ({ value, name: t(`events.level.${value || "all"}`) }));
  const bar = (sources: readonly string[]) => {
    const options = [
      { value: "", name: t("events.allSources") },
      ...[...new Set([...sources, ...(source === "" ? [] : [source])])].map((one) => ({
        value: one,
        name: t(`common:services.${one}`, { defaultValue: one }),
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

/** What passes the filter of all that is kept, not only of what is visible. */
function Exports({ filter }: { filter: EventFilter }) {
  const { t } = useTranslation("system");
  const said = useMessageText();
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const take = (kind: "csv" | "json") => {
    setBusy(true);
    setFailure(null);
    void allEvents((before) => eventsBefore(before, EXPORT_PAGE))
      .then((all) => {
        const events = all.filter((event) => passes(event, filter, said(event)));
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
