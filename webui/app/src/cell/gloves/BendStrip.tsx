/** The live plot of the five bends: 30 s, at most 30 updates a second, and only while visible. */
import { useCallback } from "react";
import { useTranslation } from "react-i18next";
import { useTopicSelector } from "~/live/hooks";
import type { Finger } from "~/live/messages";
import { fingers } from "~/hand/geometry";
import { dashes } from "~/plot/fingers";
import { bendOptions, useBendPlot, type Look } from "~/plot/useBendPlot";
import { useShownTheme } from "~/shell/theme";
import "./BendStrip.css";

const SECONDS = 30;
const LINE_PX = 2;

export default function BendStrip({ glove }: { glove: string }) {
  const { t, i18n } = useTranslation(["system", "hand"]);
  const theme = useShownTheme();
  const look = useCallback<Look>(
    (host, seconds, now) => bendOptions(host, seconds, now, i18n.language, () => LINE_PX),
    // The plot reads the colours of the theme only when it is created.
    // eslint-disable-next-line react-hooks/exhaustive-deps -- create the plot again for a new theme
    [i18n.language, theme],
  );
  const { place } = useBendPlot(glove, SECONDS, look);

  return (
    <figure className="bend-strip" aria-label={t("glove.strip")}>
      <div ref={place} className="bend-strip__plot" aria-hidden />
      <figcaption className="bend-strip__legend">
        {fingers.map((finger, number) => (
          <Legend key={finger} glove={glove} finger={finger} number={number} />
        ))}
      </figcaption>
    </figure>
  );
}

function Legend({ glove, finger, number }: { glove: string; finger: Finger; number: number }) {
  const { t } = useTranslation(["system", "hand"]);
  const state = useTopicSelector(`glove/${glove}`, (view) => view?.states?.[number] ?? null);
  return (
    <span className="bend-strip__finger">
      <svg width="28" height="8" aria-hidden>
        <line x1="0" x2="28" y1="4" y2="4" strokeWidth="2.5" stroke={`var(--finger-${number})`} strokeDasharray={dashes[number]?.join(" ")} />
      </svg>
      {t(`hand:finger.${finger}`)} <span className="quiet">{state === null ? t("glove.unknown") : t(`glove.bend.${state}`)}</span>
    </span>
  );
}
