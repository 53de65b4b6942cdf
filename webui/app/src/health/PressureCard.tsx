/** The pressure on a mat: its cells, darker for more, and the centre of pressure. */
import { useTranslation } from "react-i18next";
import { Card } from "~/design/Card";
import { StatusBadge } from "~/design/StatusBadge";
import { useNow } from "~/live/clock";
import { pressureGrid, SILENT_S } from "./health";
import type { PressureMap } from "./liveSignals";

export function PressureCard({ map }: { map: PressureMap }) {
  const { t } = useTranslation("health");
  const grid = pressureGrid(map.channels, map.values);
  const isSilent = useNow() - map.receivedMs > SILENT_S * 1000;
  if (grid === null) return null;
  return (
    <Card title={t("pressure.title")} className="health__pressure" aside={isSilent ? <StatusBadge tone="attention">{t("trust.stale")}</StatusBadge> : <span className="quiet small">{map.sensor}</span>}>
      <svg className="pressure-map" data-stale={isSilent || undefined} viewBox={`0 0 ${grid.columns} ${grid.rows}`} role="img" aria-label={t("pressure.label", { rows: grid.rows, columns: grid.columns })}>
        {grid.cells.map((line, row) =>
          line.map((share, column) => <rect key={`${row} ${column}`} x={column + 0.02} y={row + 0.02} width={0.96} height={0.96} className={share === null ? "pressure-map__missing" : "pressure-map__cell"} fillOpacity={share === null ? 1 : 0.06 + 0.94 * share} />),
        )}
        {grid.centre !== null && (
          <g className="pressure-map__centre" transform={`translate(${grid.centre.x} ${grid.centre.y})`}>
            <circle r={0.16} />
            <path d="M-0.3 0H0.3M0-0.3V0.3" />
          </g>
        )}
      </svg>
      <p className="quiet small">{t("pressure.means")}</p>
    </Card>
  );
}
