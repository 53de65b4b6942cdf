/**
 * A time as "12 s ago". The exact time appears on hover and while the row of a table has the focus. Outside a
 * table the time is a tab stop itself (`isStop`).
 */
import { useTranslation } from "react-i18next";
import { useNow } from "~/live/clock";
import { ago, exactTime } from "./times";
import "./RelativeTime.css";

export function RelativeTime({ at, isStop = false }: { at: string; isStop?: boolean }) {
  const { i18n } = useTranslation();
  const now = useNow();
  const exact = exactTime(at, i18n.language);
  return (
    <time dateTime={at} className="relative-time" title={exact} data-exact={exact} {...(isStop ? { tabIndex: 0, role: "note" } : {})}>
      {ago(Date.parse(at), now, i18n.language)}
    </time>
  );
}
