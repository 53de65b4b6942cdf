/** History: the processes that have ended, as far back as somebody has looked. */
import { useCallback, useEffect, useState } from "react";
import { describe } from "~/api/http";
import { useFamily } from "~/live/hooks";
import { processesBefore } from "../records";
import { KEPT_ENDED, remembered, together, type ProcessRow, type Sections } from "./rows";

const PAGE = 50;

export interface History {
  sections: Sections;
  /** There may be older ones. */
  more: boolean;
  failure: string | null;
  older: () => void;
}

export function useHistory(): History {
  const live = useFamily("process");
  const [history, setHistory] = useState<readonly ProcessRow[]>([]);
  const [mark, setMark] = useState<string | null>(null);
  const [asks, setAsks] = useState(0);
  const [more, setMore] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);

  useEffect(() => {
    let left = false;
    processesBefore(mark, PAGE).then(
      (rows) => {
        if (left) return;
        setFailure(null);
        setHistory((before) => remembered(before, rows));
        setMore(rows.length === PAGE);
      },
      (error: unknown) => {
        if (!left) setFailure(describe(error));
      },
    );
    return () => {
      left = true;
    };
  }, [mark, asks]);

  // A process leaves the live view some while after its end; the list remembers it.
  const kept = remembered(history, live);
  if (kept !== history) setHistory(kept);

  const sections = together(live, kept);
  const last = sections.ended.reduce<ProcessRow | null>(
    (oldest, row) => (oldest === null || row.startedAt < oldest.startedAt ? row : oldest),
    null,
  );
  const lastId = last?.id ?? null;
  const older = useCallback(() => {
    setMark(lastId);
    setAsks((count) => count + 1);
  }, [lastId]);
  return { sections, more: more && sections.ended.length < KEPT_ENDED, failure, older };
}
