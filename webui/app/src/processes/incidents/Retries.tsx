/** The steps whose task has failed and is posted again: when, and after how many attempts. */
import { Hourglass } from "lucide-react";
import { useTranslation } from "react-i18next";
import { exactTime } from "~/design/times";
import { localizedText } from "~/i18n/server";
import { useNow } from "~/live/clock";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { elementName, type BpmnElements } from "../diagram/elements";
import { RetryButton } from "./RetryButton";
import "./Incidents.css";

export function Retries({ process, elements }: { process: ProcessView; elements: BpmnElements }) {
  const { t, i18n } = useTranslation("processes");
  const now = useNow();
  if (process.retries.length === 0) return null;
  return (
    <section className="incidents retries" aria-label={t("retries.list", { count: process.retries.length })}>
      <ul>
        {process.retries.map((waiting) => {
          const step = waiting.name === "" ? elementName(elements, waiting.element) : waiting.name;
          return (
            <li key={waiting.token} className="incident incident--waits">
              <Hourglass aria-hidden size={20} className="incident__icon" />
              <div className="incident__what">
                <p>
                  <strong>{step}</strong>{" "}
                  <span className="quiet small">{t("retries.failed", { failed: waiting.failed, attempts: waiting.attempts })}</span>
                </p>
                <p>
                  {t("retries.due", { time: exactTime(waiting.due, i18n.language), seconds: Math.max(0, Math.ceil((Date.parse(waiting.due) - now) / 1000)) })}
                </p>
                <p className="incident__reason">{localizedText(waiting, "reason")}</p>
              </div>
              <div className="incident__acts">
                <RetryButton process={process} token={waiting.token} step={step} kind="plain" />
              </div>
            </li>
          );
        })}
      </ul>
    </section>
  );
}
