/** The processes behind the statistics: filtered, as long as one scrolls, and as an event log. */
import { useInfiniteQuery } from "@tanstack/react-query";
import { useEffect, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { useLocation } from "wouter";
import type { ProcessSummary } from "~/api/generated/task-orchestrator";
import { errorText } from "~/api/http";
import { queryClient } from "~/api/useServiceQuery";
import { useProcessTexts } from "~/live/hooks";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { RelativeTime } from "~/design/RelativeTime";
import { Select } from "~/design/Select";
import { StatusBadge } from "~/design/StatusBadge";
import { processTone } from "~/design/states";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { duration } from "~/design/times";
import { localizedText } from "~/i18n/server";
import { processState } from "~/live/processState";
import { shortName } from "~/live/urn";
import { pathOf } from "~/processes/address";
import { useQueryParameter } from "~/route/queryParameter";
import { Export } from "../Export";
import type { Scope } from "../query";
import { REFRESH_MS } from "../statistics/useStatistics";
import { listQuery, PAGE, processPage, STATES, TIMES, type ListFilter } from "./filter";

const TYPING_MS = 400;
/** Longer lists are not asked for again by themselves. */
const MAX_LIVE_PAGES = 3;

export interface ProcessTableProps {
  scope: Scope;
  element: string;
  onElement: (element: string) => void;
  resources: readonly string[];
}

export function ProcessTable({ scope, element, onElement, resources }: ProcessTableProps) {
  const { t } = useTranslation(["cockpit", "common"]);
  const [, go] = useLocation();
  const { filter, bar } = useFilter(element, onElement, resources);
  const [sorting, setSorting] = useSorting("", "processSort");
  const columns = useColumns();
  const query = useMemo(() => listQuery(filter, scope).toString(), [filter, scope]);
  const pages = useInfiniteQuery(
    {
      queryKey: ["cockpit processes", query],
      queryFn: ({ pageParam }) => processPage(query, pageParam),
      initialPageParam: null as string | null,
      getNextPageParam: (page) => (page.length === PAGE ? page.at(-1)?.id : undefined),
      refetchInterval: (state) => ((state.state.data?.pages.length ?? 0) > MAX_LIVE_PAGES ? false : REFRESH_MS),
    },
    queryClient,
  );
  const texts = useProcessTexts();
  const rows = useMemo(() => texts.localized(pages.data?.pages.flat() ?? []), [texts, pages.data]);
  const fault = pages.error ?? pages.failureReason;
  const exports = (
    <span className="cockpit__exports">
      <Export path={`event-log?${query}`} name="processes" format="csv" />
      <Export path={`event-log?${query}`} name="processes" format="xes" />
    </span>
  );
  return (
    <Card className="process-table" title={t("processes.title")} aside={exports}>
      {bar}
      {fault !== null && <ErrorMessage>{errorText(fault)}</ErrorMessage>}
      {pages.data !== undefined && rows.length === 0 ? (
        <p className="quiet">{t("processes.none")}</p>
      ) : (
        <DataTable
          label={t("processes.title")}
          rows={rows}
          columns={columns}
          keyOf={(row) => row.id}
          nameOf={(row) => `${row.title} ${row.key ?? row.id}`}
          rowHeight={56}
          isLabelled
          view={query}
          sorting={sorting}
          onSort={setSorting}
          onOpen={(row) => go(pathOf({ kind: "process", id: row.id }))}
          onEnd={pages.hasNextPage && !pages.isFetching ? () => void pages.fetchNextPage() : undefined}
        />
      )}
    </Card>
  );
}

function useFilter(element: string, onElement: (element: string) => void, resources: readonly string[]) {
  const { t } = useTranslation(["cockpit", "common"]);
  const [state, setState] = useQueryParameter("state");
  const [search, setSearch] = useTyped("find");
  const [variables, setVariables] = useTyped("where");
  const [resource, setResource] = useQueryParameter("involves");
  const [time, setTime] = useQueryParameter("time");
  const filter: ListFilter = useMemo(
    () => ({ state, search: search.given, variables: variables.given, resource, time, element }),
    [state, search.given, variables.given, resource, time, element],
  );
  const any = { value: "", name: t("processes.any") };
  const known = resource === "" || resources.includes(resource) ? resources : [resource, ...resources];
  const bar = (
    <div className="cockpit__bar" role="search" aria-label={t("processes.filter")}>
      <Field label={t("processes.find")} type="search" value={search.typed} onChange={setSearch} />
      <Field label={t("processes.variables")} placeholder="order.total>=100; customer=Acme" value={variables.typed} onChange={setVariables} />
      <Select label={t("processes.state")} value={state} options={[any, ...STATES.map((value) => ({ value, name: t(`processes.states.${value}`) }))]} onChange={setState} />
      <Select label={t("processes.resource")} value={resource} options={[any, ...known.map((value) => ({ value, name: shortName(value) }))]} onChange={setResource} />
      <Select label={t("processes.time")} value={time} options={[any, ...TIMES.map((value) => ({ value, name: t(`processes.times.${value}`) }))]} onChange={setTime} />
      {element !== "" && <Button onPress={() => onElement("")}>{t("processes.anyElement", { element })}</Button>}
    </div>
  );
  return { filter, bar };
}

/** A parameter of the URL that changes when the user pauses typing. */
function useTyped(name: string) {
  const [given, setGiven] = useQueryParameter(name);
  const [typed, setTyped] = useState(given);
  useEffect(() => {
    const timer = setTimeout(() => setGiven(typed), TYPING_MS);
    return () => clearTimeout(timer);
    // eslint-disable-next-line react-hooks/exhaustive-deps -- the setter changes with each change of the URL
  }, [typed]);
  return [{ given, typed }, setTyped] as const;
}

function useColumns(): readonly Column<ProcessSummary>[] {
  const { t, i18n } = useTranslation(["cockpit", "common"]);
  return useMemo(() => {
    const took = (row: ProcessSummary) => (row.endedAt === null ? null : Date.parse(row.endedAt) - Date.parse(row.startedAt));
    return [
      {
        id: "key", name: t("processes.key"), width: "minmax(140px, 1.6fr)", sortBy: (row) => row.name,
        cell: (row) => (
          <>
            <span className="cell__name">{row.name}</span>
            <p className="cell__detail">{t("processes.of", { title: row.title, version: row.version })}</p>
          </>
        ),
      },
      {
        id: "state", name: t("processes.state"), width: "minmax(130px, 1fr)", sortBy: processState,
        cell: (row) => <StatusBadge tone={processTone[processState(row)]}>{t(`common:processStatus.${processState(row)}`)}</StatusBadge>,
      },
      { id: "where", name: t("processes.where"), width: "minmax(180px, 2.4fr)", cell: (row) => <span>{whereOf(row)}</span> },
      { id: "started", name: t("processes.started"), width: "minmax(90px, 0.8fr)", sortBy: (row) => row.startedAt, isDescendingFirst: true, cell: (row) => <RelativeTime at={row.startedAt} /> },
      {
        id: "took", name: t("processes.took"), width: "minmax(90px, 0.8fr)", isNumber: true, isDescendingFirst: true, sortBy: took,
        cell: (row) => {
          const ms = took(row);
          return <span>{ms === null ? "–" : duration(ms, i18n.language)}</span>;
        },
      },
    ];
  }, [t, i18n.language]);
}

/** What a process waits for: its first incident or activity without a performer; why it has ended otherwise. */
function whereOf(row: ProcessSummary): string {
  const first = row.incidents[0] ?? row.unallocated[0];
  if (first !== undefined) return `${first.name === "" ? first.element : first.name}: ${localizedText(first, "reason") ?? ""}`;
  return row.endedAt === null ? row.waiting.join(", ") : (localizedText(row, "reason") ?? "–");
}
