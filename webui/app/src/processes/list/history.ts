/** The processes that pass a filter: the live ones, and the ended ones as far back as the user has scrolled. */
import { useInfiniteQuery, useQuery } from "@tanstack/react-query";
import { useEffect, useMemo, useState } from "react";
import { errorText } from "~/api/http";
import { queryClient } from "~/api/useServiceQuery";
import { useFamily, useProcessTexts } from "~/live/hooks";
import { processesBefore } from "../records";
import { MAX_ENDED, passes, remembered, together, type ProcessFilter, type ProcessRow, type ProcessSorting, type Sections } from "./rows";

const PAGE = 100;
const SEARCH_DELAY_MS = 300;

export interface History {
  sections: Sections;
  /** There may be older processes. */
  more: boolean;
  failure: string | null;
  loadOlder: () => void;
}

interface Seen {
  key: string;
  rows: readonly ProcessRow[];
}

/** The orchestrator searches all processes that it stores for `words`. */
export function useHistory(filter: ProcessFilter, words: string, sorting: ProcessSorting): History {
  const live = useFamily("process");
  const texts = useProcessTexts();
  const key = JSON.stringify(filter);
  const search = useDelayed(words.trim(), SEARCH_DELAY_MS);
  const pages = useInfiniteQuery(
    {
      queryKey: ["processes", key],
      queryFn: ({ pageParam }) => processesBefore(pageParam, PAGE, filter),
      initialPageParam: null as string | null,
      getNextPageParam: (page) => (page.length === PAGE ? page.at(-1)?.id : undefined),
      staleTime: Infinity, // the live view has what changes
      retry: true, // the orchestrator may be starting
    },
    queryClient,
  );
  const found = useQuery(
    { queryKey: ["processes", key, "search", search], queryFn: () => processesBefore(null, PAGE, filter, search), enabled: search !== "", retry: false },
    queryClient,
  );

  const passing = useMemo(() => live.filter((row) => passes(row, filter)), [live, filter]);
  // A process leaves the live view some time after its end; the list keeps it.
  const [seen, setSeen] = useState<Seen>({ key, rows: [] });
  const ended = remembered(seen.key === key ? seen.rows : [], passing);
  if (seen.key !== key || seen.rows !== ended) setSeen({ key, rows: ended });
  const rows = useMemo(
    () => texts.localized([...(pages.data?.pages ?? []), found.data ?? []]).reduce(remembered, ended),
    [texts, pages.data, found.data, ended],
  );

  const sections = useMemo(() => together(passing, rows.filter((row) => passes(row, filter)), sorting), [passing, rows, filter, sorting]);
  const fault = pages.error ?? pages.failureReason;
  return {
    sections,
    more: pages.hasNextPage && sections.ended.length < MAX_ENDED,
    failure: fault === null ? null : errorText(fault),
    loadOlder: () => {
      if (!pages.isFetching) void pages.fetchNextPage();
    },
  };
}

function useDelayed(value: string, delayMs: number): string {
  const [delayed, setDelayed] = useState(value);
  useEffect(() => {
    const timer = setTimeout(() => setDelayed(value), delayMs);
    return () => clearTimeout(timer);
  }, [value, delayMs]);
  return delayed;
}
