/** The words of the marks, in the language of the page. */
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import { duration } from "~/design/times";
import type { MarkWords } from "./marks";

/** For one process `lastMs` is the news, over all of them the median. */
export function useMarkWords(over: "process" | "all"): MarkWords {
  const { t, i18n } = useTranslation("processes");
  return useMemo(() => {
    const said = (ms: number | null) => (ms === null ? "–" : duration(ms, i18n.language));
    return {
      token: (count) => t("marks.token", { count }),
      incident: (count) => t("marks.incident", { count }),
      failed: (count) => t("marks.failed", { count }),
      count: (count) => ({ text: String(count), title: t("marks.done", { count }) }),
      duration: (lastMs, medianMs) => ({
        text: said(over === "process" ? (lastMs ?? medianMs) : (medianMs ?? lastMs)),
        title: t("marks.took", { last: said(lastMs), median: said(medianMs) }),
      }),
    };
  }, [t, i18n.language, over]);
}
