/** The list at the left: what can run, what runs, what has run. It keeps its place while somebody is in it. */
import { FileUp, Inbox, ListFilter, Play } from "lucide-react";
import { useMemo, useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link, useLocation, useSearch } from "wouter";
import { RelativeTime } from "~/design/RelativeTime";
import { Button } from "~/design/Button";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { processTone } from "~/design/states";
import { useIsReading } from "~/design/table/useStableOrder";
import { VirtualGrid, type Line } from "~/design/table/VirtualGrid";
import { useFamily } from "~/live/hooks";
import type { DefinitionView } from "~/api/generated/task-orchestrator";
import { processState, type ProcessState } from "~/live/processState";
import { shortName } from "~/live/urn";
import { useChoice } from "~/route/choice";
import { useQueryParameter } from "~/route/queryParameter";
import { pathOf, samePlace, type Place } from "../address";
import { PaceButton } from "../pause/PaceButton";
import { useHistory } from "./history";
import { activityOf, found, foundDefinitions, held, sameSections, SORT_ORDERS, type ProcessFilter, type ProcessRow, type Sections } from "./rows";
import "./ProcessList.css";

/** So many definitions stand above the processes; the others are shown when asked for. */
const MAX_DEFINITIONS = 5;
const STATES = ["incident", "inProgress", "paused", "completed", "failed"] as const;
/** The parts of the URL's query that belong to the list and stay when another process is opened. */
const OWN_QUERY = ["find", "state", "of", "involves", "sort"];

type Item = { kind: "definition"; definition: DefinitionView } | { kind: "process"; row: ProcessRow };

export interface ProcessListProps {
  place: Place;
  onStart: (definition: DefinitionView) => void;
  onUpload: () => void;
  /** How many definitions of other systems wait for a decision. */
  offers: number;
  onOffers: () => void;
}

export function ProcessList({ place, onStart, onUpload, offers, onOffers }: ProcessListProps) {
  const { t } = useTranslation(["processes", "common"]);
  const [, go] = useLocation();
  const { filter, find, sorting, bar } = useView();
  const allDefinitions = useFamily("definition");
  const [showsAll, setShowsAll] = useState(false);
  const definitions = useMemo(() => foundDefinitions(allDefinitions, find), [allDefinitions, find]);
  const history = useHistory(filter, find, sorting);
  const { isReading, handlers } = useIsReading();
  const { sections, waiting, release } = useHeld(
    history.sections, place.kind === "process" ? place.id : null, isReading, JSON.stringify([filter, sorting]),
  );
  const said = (state: ProcessState) => t(`common:processStatus.${state}`);
  const running = found(sections.running, find, said);
  const ended = found(sections.ended, find, said);
  const address = useAddress();

  const shown = showsAll || find !== "" ? definitions : definitions.slice(0, MAX_DEFINITIONS);
  const isFiltered = find !== "" || filter.status !== "" || filter.definition !== "" || filter.involves !== "";
  const group = (key: string, name: ReactNode): Line<Item> => ({ kind: "group", key, name });
  const empty = (key: string, words: string) => group(key, <span className="process-list__empty">{isFiltered ? t("list.notFound") : words}</span>);
  const ofProcess = (row: ProcessRow): Line<Item> => ({ kind: "row", key: `process ${row.id}`, row: { kind: "process", row } });
  const lines: Line<Item>[] = [
    group("definitions", <h2>{t("list.definitions", { count: definitions.length })}</h2>),
    ...shown.map((definition): Line<Item> => ({ kind: "row", key: `definition ${definition.name}`, row: { kind: "definition", definition } })),
    ...(definitions.length === 0 ? [empty("no definitions", t("list.noDefinitions"))] : []),
    ...(shown.length < definitions.length
      ? [group("all definitions", <Button kind="quiet" onPress={() => setShowsAll(true)}>{t("list.allDefinitions", { count: definitions.length })}</Button>)]
      : []),
    group("running", <h2>{t("list.running", { count: running.length })}</h2>),
    ...running.map(ofProcess),
    ...(running.length === 0 ? [empty("none runs", t("list.noneRuns"))] : []),
    group("ended", <h2>{t("list.ended", { count: ended.length })}</h2>),
    ...ended.map(ofProcess),
    ...(ended.length === 0 ? [empty("none ended", t("list.noneEnded"))] : []),
  ];
  const placeOf = (item: Item): Place =>
    item.kind === "definition" ? { kind: "definition", name: item.definition.name } : { kind: "process", id: item.row.id };
  const column = {
    id: "item",
    name: t("list.label"),
    width: "minmax(0, 1fr)",
    cell: (item: Item) => (
      <div className="process-list__row">
        <Link href={address(placeOf(item))} className="process-list__link" tabIndex={-1} aria-current={samePlace(placeOf(item), place) ? "page" : undefined}>
          {item.kind === "definition" ? <Definition definition={item.definition} /> : <Process row={item.row} />}
        </Link>
        {item.kind === "definition" && item.definition.unusable === undefined && (
          <Button permission="runProcesses"
            kind="quiet"
            label={t("start.act", { title: item.definition.title })}
            icon={<Play aria-hidden size={18} />}
            onPress={() => onStart(item.definition)}
          />
        )}
      </div>
    ),
  };
  return (
    <aside className="process-list" aria-label={t("list.label")} {...handlers}>
      <div className="process-list__head">
        {bar}
        <Button permission="deployProcesses" icon={<FileUp aria-hidden size={18} />} onPress={onUpload}>
          {t("list.upload")}
        </Button>
        {offers > 0 && (
          <Button icon={<Inbox aria-hidden size={18} />} aria-current={place.kind === "offers"} onPress={onOffers}>
            {t("list.offers", { count: offers })}
          </Button>
        )}
        {sections.running.some(({ status }) => status !== "paused") && <PaceButton pace="pause" of="everything" />}
        {sections.running.some(({ status }) => status === "paused") && <PaceButton pace="resume" of="everything" />}
      </div>
      {history.failure !== null && <ErrorMessage>{t("list.unread", { why: history.failure })}</ErrorMessage>}
      <VirtualGrid
        label={t("list.label")}
        lines={lines}
        columns={[column]}
        rowHeight={84}
        nameOf={(item) =>
          item.kind === "definition"
            ? item.definition.title
            : `${item.row.name}, ${said(processState(item.row))}`
        }
        onOpen={(item) => go(address(placeOf(item)))}
        onEnd={history.more ? history.loadOlder : undefined}
      />
      {waiting > 0 && (
        <div className="process-list__news">
          <Button onPress={release}>{t("list.news", { count: waiting })}</Button>
        </div>
      )}
    </aside>
  );
}

function Definition({ definition }: { definition: DefinitionView }) {
  const { t } = useTranslation("processes");
  return (
    <>
      <span className="process-list__title">{definition.title}</span>
      <span className="process-list__more">
        {definition.unusable === undefined ? (
          t("version", { version: definition.version })
        ) : (
          <StatusBadge tone="stop">{t("list.unusable")}</StatusBadge>
        )}
      </span>
    </>
  );
}

/** Its name; that of its definition too, unless it is a part of it. */
function Process({ row }: { row: ProcessRow }) {
  const { t } = useTranslation(["processes", "common"]);
  const activity = activityOf(row);
  const state = processState(row);
  return (
    <>
      <span className="process-list__title">{row.name}</span>
      <span className="process-list__more">
        <StatusBadge tone={processTone[state]}>{t(`common:processStatus.${state}`)}</StatusBadge>
        <span className="process-list__time quiet">
          <RelativeTime at={row.endedAt ?? row.startedAt} />
        </span>
      </span>
      <span className="process-list__where quiet">
        {[row.name.startsWith(row.title) ? null : row.title, activity || null].filter(Boolean).join(" · ")}
      </span>
    </>
  );
}

/** The filter and the sorting, which the URL holds, and the bar that sets them. */
function useView() {
  const { t } = useTranslation(["processes", "common"]);
  const [find, setFind] = useQueryParameter("find");
  const [status, setStatus] = useQueryParameter("state");
  const [definition, setDefinition] = useQueryParameter("of");
  const [involves, setInvolves] = useQueryParameter("involves");
  const [sorting, setSort] = useChoice("sort", SORT_ORDERS, "newest");
  const filter: ProcessFilter = useMemo(() => ({ status, definition, involves }), [status, definition, involves]);
  const isSet = status !== "" || definition !== "" || involves !== "" || sorting !== "newest";
  const [isOpen, setOpen] = useState(isSet);
  const bar = (
    <>
      <div className="process-list__find">
        <Field label={t("list.find")} type="search" value={find} onChange={setFind} />
        <Button
          kind={isSet ? "main" : "plain"}
          label={t("list.filter")}
          aria-expanded={isOpen}
          icon={<ListFilter aria-hidden size={18} />}
          onPress={() => setOpen(!isOpen)}
        />
      </div>
      {isOpen && (
        <Filters filter={filter} onStatus={setStatus} onDefinition={setDefinition} onInvolves={setInvolves}>
          <Select label={t("list.sort")} value={sorting} options={SORT_ORDERS.map((value) => ({ value, name: t(`list.sorting.${value}`) }))} onChange={setSort} />
        </Filters>
      )}
    </>
  );
  return { filter, find, sorting, bar };
}

interface FiltersProps {
  filter: ProcessFilter;
  onStatus: (value: string) => void;
  onDefinition: (value: string) => void;
  onInvolves: (value: string) => void;
  children: ReactNode;
}

function Filters({ filter, onStatus, onDefinition, onInvolves, children }: FiltersProps) {
  const { t } = useTranslation(["processes", "common"]);
  const processes = useFamily("process");
  const definitions = useFamily("definition");
  const all = { value: "", name: t("list.any") };
  const versions = definitions.flatMap(({ name, title, version }) => [
    { value: name, name: title },
    ...Array.from({ length: version }, (_, nth) => ({ value: `${name}@${version - nth}`, name: `${title}, ${t("version", { version: version - nth })}` })),
  ]);
  const people = new Set(processes.flatMap((process) => process.tasks.flatMap((task) => task.involves)));
  if (filter.involves !== "") people.add(filter.involves);
  return (
    <div className="process-list__filters">
      <Select label={t("list.state")} value={filter.status} options={[all, ...STATES.map((value) => ({ value, name: t(`common:processStatus.${value}`) }))]} onChange={onStatus} />
      <Select label={t("list.definition")} value={filter.definition} options={[all, ...versions]} onChange={onDefinition} />
      <Select label={t("list.involves")} value={filter.involves} options={[all, ...[...people].sort().map((value) => ({ value, name: shortName(value) }))]} onChange={onInvolves} />
      {children}
    </div>
  );
}

/** The address of a place, with the filter of the list. */
function useAddress(): (to: Place) => string {
  const query = new URLSearchParams(useSearch());
  for (const name of [...query.keys()]) if (!OWN_QUERY.includes(name)) query.delete(name);
  const kept = query.toString();
  return (to) => `${pathOf(to)}${kept === "" ? "" : `?${kept}`}`;
}

/**
 * The list as it is shown: held in place from the moment somebody is in it until they have left. A process
 * that is opened is shown at once, because the person who started it looks for it.
 */
function useHeld(now: Sections, opened: string | null, isReading: boolean, signature: string) {
  const [kept, setKept] = useState({ signature, sections: now });
  const before = kept.sections;
  // What was read into an empty list is no news that could move anything.
  const isFirst = before.running.length + before.ended.length === 0 || (has(now, opened) && !has(before, opened));
  const follows = !isReading || isFirst || kept.signature !== signature;
  if (follows && (kept.signature !== signature || !sameSections(before, now))) setKept({ signature, sections: now });
  const { sections, waiting } = follows ? { sections: now, waiting: 0 } : held(before, now);
  return { sections, waiting, release: () => setKept({ signature, sections: now }) };
}

function has(sections: Sections, id: string | null): boolean {
  return [...sections.running, ...sections.ended].some((row) => row.id === id);
}
