/** A time as "12 s ago"; the exact one on hover and focus. */
import { useTranslation } from "react-i18next";
import { Focusable, Tooltip, TooltipTrigger } from "react-aria-components";
import { useNow } from "~/live/clock";
import { ago } from "./times";
import "./Ago.css";

export function Ago({ at }: { at: string }) {
  const { i18n } = useTranslation();
  const now = useNow();
  const exact = new Date(at).toLocaleString(i18n.language, { dateStyle: "medium", timeStyle: "medium" });
  return (
    <TooltipTrigger delay={300}>
      <Focusable>
        <time dateTime={at} className="ago" role="note" tabIndex={0}>
          {ago(Date.parse(at), now, i18n.language)}
        </time>
      </Focusable>
      <Tooltip className="ago__exact">{exact}</Tooltip>
    </TooltipTrigger>
  );
}
