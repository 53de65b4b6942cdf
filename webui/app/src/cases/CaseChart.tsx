/** The last minutes of a machine: a panel for each unit. */
import { useTranslation } from "react-i18next";
import type { HistoryView } from "~/api/generated/assistive-devices";
import { number } from "~/design/numbers";
import { linePath, panelsOf, valueText } from "./cases";

const WIDTH = 800;
const HEIGHT = 120;

export function CaseChart({ history }: { history: HistoryView }) {
  const { t, i18n } = useTranslation("cases");
  const fromS = history.atS[0] ?? 0;
  const toS = history.atS.at(-1) ?? 1;
  return (
    <div className="case-chart">
      {panelsOf(history).map((panel) => (
        <figure key={panel.curves[0]?.name} className="case-chart__panel">
          <figcaption className="small">
            {panel.curves.map(({ name, last }, place) => (
              <span key={name} className="case-chart__name" data-curve={place}>
                {t(`value.${name}`, { defaultValue: name })} {last === null ? "–" : valueText(last, panel.unit, i18n.language)}
              </span>
            ))}
          </figcaption>
          <svg viewBox={`0 0 ${WIDTH} ${HEIGHT}`} preserveAspectRatio="none" role="img" aria-label={panel.curves.map(({ name }) => t(`value.${name}`, { defaultValue: name })).join(", ")}>
            {panel.curves.map((curve, place) => (
              <path key={curve.name} data-curve={place} d={linePath(curve, panel, fromS, toS, WIDTH, HEIGHT)} vectorEffect="non-scaling-stroke" />
            ))}
          </svg>
          <p className="case-chart__range small quiet">
            {t("range", { low: valueText(panel.low, panel.unit, i18n.language), high: valueText(panel.high, panel.unit, i18n.language), seconds: number(toS - fromS, i18n.language, { maximumFractionDigits: 0 }) })}
          </p>
        </figure>
      ))}
    </div>
  );
}
