/** Until when a Task is to be done: overdue, due soon, or later. */
import { CalendarClock } from "lucide-react";
import { useTranslation } from "react-i18next";
import { StatusBadge, type Tone } from "~/design/StatusBadge";
import { exactTime, span } from "~/design/times";
import { useNow } from "~/live/clock";
import { urgencyOf, type Urgency } from "./list";

const TONES: Record<Urgency, Tone> = { overdue: "stop", soon: "attention", later: "neutral" };

export function DueMark({ dueDate }: { dueDate: string }) {
  const { t, i18n } = useTranslation("tasks");
  const now = useNow();
  const urgency = urgencyOf(dueDate, now);
  const left = span(Math.abs(Date.parse(dueDate) - now) / 1000, i18n.language);
  return (
    <span title={exactTime(dueDate, i18n.language)}>
      <StatusBadge tone={TONES[urgency]} icon={<CalendarClock aria-hidden size="1.15em" />}>
        {t(urgency === "overdue" ? "due.overdue" : "due.in", { span: left })}
      </StatusBadge>
    </span>
  );
}
