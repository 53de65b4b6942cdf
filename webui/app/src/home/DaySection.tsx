/** How the day goes: what ended, and how that compares with yesterday by the same time, where it does. */
import { useTranslation } from "react-i18next";
import type { PeriodStatistics } from "~/api/generated/task-orchestrator";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Loading } from "~/design/Loading";
import { number } from "~/design/numbers";
import { clockTime, duration } from "~/design/times";
import { useNow } from "~/live/clock";
import { useFamily } from "~/live/hooks";
import { beganToday, comparable, MIN_FOR_COMPARISON, startOfDay, untilNowYesterday } from "./day";

const POLL_INTERVAL_MS = 15_000;

export function DaySection() {
  const { t, i18n } = useTranslation("home");
  const now = useNow();
  const midnight = startOfDay(now);
  const asked = untilNowYesterday(now);
  const ended = useFamily("process").filter((process) => process.endedAt !== null).map((process) => process.id).join();
  const today = useServiceQuery<PeriodStatistics>("task-orchestrator", `statistics?since=${encodeURIComponent(midnight)}`, { revision: ended, intervalMs: POLL_INTERVAL_MS, keepsPrevious: true });
  const path = `statistics?since=${encodeURIComponent(asked.since)}&until=${encodeURIComponent(asked.until)}`;
  const yesterday = comparable(useServiceQuery<PeriodStatistics>("task-orchestrator", path, { keepsPrevious: true }).value, asked.since);
  const began = beganToday(today.value, midnight);
  const title = began === null ? t("day.title") : t("day.since", { time: clockTime(began, i18n.language, now) });
  const day = today.value;
  return (
    <Card className="home__section" title={title}>
      {day === null ? today.failure === null ? <Loading /> : <ErrorMessage>{today.failure}</ErrorMessage> : <Figures day={day} yesterday={yesterday} until={clockTime(asked.until, i18n.language, Date.parse(asked.until))} />}
    </Card>
  );
}

function Figures({ day, yesterday, until }: { day: PeriodStatistics; yesterday: PeriodStatistics | null; until: string }) {
  const { t, i18n } = useTranslation("home");
  const formatted = (value: number) => number(value, i18n.language);
  const { medianMs } = day;
  const before = yesterday !== null && yesterday.completed >= MIN_FOR_COMPARISON && day.completed >= MIN_FOR_COMPARISON ? yesterday.medianMs : null;
  const medianNote = before === null ? t("day.of", { count: day.completed }) : t("day.before", { value: duration(before, i18n.language) });
  return (
    <>
      <dl className="home__figures">
        <Figure name={t("day.completed")} note={yesterday && t("day.before", { value: formatted(yesterday.completed) })}>
          {formatted(day.completed)}
        </Figure>
        <Figure name={t("day.failed")} isBad={day.failed > 0} note={yesterday && t("day.before", { value: formatted(yesterday.failed) })}>
          {formatted(day.failed)}
        </Figure>
        {medianMs !== null && day.completed > 0 && (
          <Figure name={t(day.completed === 1 ? "day.duration" : "day.median")} note={medianNote}>
            {duration(medianMs, i18n.language)}
          </Figure>
        )}
      </dl>
      {yesterday !== null && <p className="quiet small">{t("day.compared", { time: until })}</p>}
    </>
  );
}

function Figure({ name, note, isBad = false, children }: { name: string; note: string | null; isBad?: boolean; children: string }) {
  return (
    <div>
      <dt className="quiet small">{name}</dt>
      <dd data-bad={isBad || undefined}>
        {children}
        {note !== null && <span className="home__note quiet small">{note}</span>}
      </dd>
    </div>
  );
}
