/** The processes that pass a filter: the live ones, and those that have ended, as far back as somebody has looked. */
import { useEffect, useMemo, useState } from "react";
import { describe } from "~/api/http";
import { useFamily } from "~/live/hooks";
import { processesBefore } from "../records";
import { KEPT_ENDED, passes, remembered, together, type ProcessFilter, type ProcessRow, type ProcessSorting, type Sections } from "./rows";

const PAGE = 100;
const SEARCH_AFTER_MS = 300;
/** What could not be read is asked for again after so long, since the orchestrator may be starting. */
const RETRY_MS = 3000;

export interface History {
  sections: Sections;
  /** There may be older ones. */
  more: boolean;
  failure: string | null;
  older: () => void;
}

interface Read {
  key: string;
  rows: readonly ProcessRow[];
  /** The process before which the next page begins; null for the first. */
  mark: string | null;
  more: boolean;
  failure: string | null;
}

const nothing = (key: string): Read => ({ key, rows: [], mark: null, more: false, failure: null });

/** `words` are looked for by the orchestrator too, in all that it keeps. */
export function useHistory(filter: ProcessFilter, words: string, sorting: ProcessSorting): History {
  const live = useFamily("process");
  const key = JSON.stringify(filter);
  const [read, setRead] = useState<Read>(nothing(key));
  const [ask, setAsk] = useState<{ key: string; before: string | null }>({ key, before: null });
  if (read.key !== key) setRead(nothing(key));
  if (ask.key !== key) setAsk({ key, before: null });

  useEffect(() => {
    let left = false;
    let retry: ReturnType<typeof setTimeout> | undefined;
    const asked = JSON.parse(ask.key) as ProcessFilter;
    processesBefore(ask.before, PAGE, asked).then(
      (rows) => {
        if (left) return;
        setRead((before) => ({
          ...before, rows: remembered(before.rows, rows), mark: rows.at(-1)?.id ?? before.mark, more: rows.length === PAGE, failure: null,
        }));
      },
      (error: unknown) => {
        if (left) return;
        setRead((before) => ({ ...before, failure: describe(error) }));
        retry = setTimeout(() => setAsk((before) => ({ ...before })), RETRY_MS);
      },
    );
    return () => {
      left = true;
      clearTimeout(retry);
    };
  }, [ask]);

  useEffect(() => {
    const search = words.trim();
    if (search === "") return;
    let left = false;
    const timer = setTimeout(() => {
      processesBefore(null, PAGE, JSON.parse(key) as ProcessFilter, search).then(
        (rows) => {
          if (!left) setRead((before) => ({ ...before, rows: remembered(before.rows, rows) }));
        },
        () => undefined, // what is loaded is searched all the same
      );
    }, SEARCH_AFTER_MS);
    return () => {
      left = true;
      clearTimeout(timer);
    };
  }, [key, words]);

  const passing = useMemo(() => live.filter((row) => passes(row, filter)), [live, filter]);
  // A process leaves the live view some while after its end; the list remembers it.
  const kept = remembered(read.rows, passing);
  if (kept !== read.rows) setRead({ ...read, rows: kept });

  const sections = useMemo(() => together(passing, kept.filter((row) => passes(row, filter)), sorting), [passing, kept, filter, sorting]);
  const { mark } = read;
  const older = () => setAsk((before) => (before.before === mark ? before : { key, before: mark }));
  return { sections, more: read.more && sections.ended.length < KEPT_ENDED, failure: read.failure, older };
}
