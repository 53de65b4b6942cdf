/** One event: when, how grave, where from, what. Drawn once; an event never changes. */
import { CircleX, Info, TriangleAlert } from "lucide-react";
import { memo } from "react";
import { useTranslation } from "react-i18next";
import { exactTime } from "~/design/times";
import type { LiveEvent } from "~/live/messages";

const icons: Record<LiveEvent["level"], typeof Info> = { info: Info, attention: TriangleAlert, stop: CircleX };

export const EventRow = memo(function EventRow({ event, said }: { event: LiveEvent; said: string }) {
  const { t, i18n } = useTranslation(["system", "common"]);
  const Icon = icons[event.level];
  const at = new Date(event.at);
  const isToday = at.toDateString() === new Date().toDateString();
  return (
    <li className={`event event--${event.level}`}>
      <time dateTime={event.at} title={exactTime(event.at, i18n.language)}>
        {!isToday && <span className="event__day">{at.toLocaleDateString(i18n.language, { day: "numeric", month: "short" })}</span>}{" "}
        {at.toLocaleTimeString(i18n.language, { timeStyle: "medium", hourCycle: "h23" })}
      </time>
      <span className="event__level">
        <Icon aria-hidden size={16} />
        <span>{t(`events.is.${event.level}`)}</span>
      </span>
      <span className="event__source">{t(`common:services.${event.source}`, { defaultValue: event.source })}</span>
      <span className="event__said">{said}</span>
    </li>
  );
});
