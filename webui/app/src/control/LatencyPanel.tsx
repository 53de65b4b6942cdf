/** How fast the robot answers, what the network adds, and how the last stop was. */
import { useTranslation } from "react-i18next";
import { number } from "~/design/numbers";
import type { ControlSnapshot } from "./connection";

export function LatencyPanel({ now }: { now: ControlSnapshot }) {
  const { t, i18n } = useTranslation("control");
  const ms = (value: number | null | undefined) => (value == null ? "–" : `${number(value, i18n.language, { maximumFractionDigits: 1 })} ms`);
  const rows = [
    ["robot", ms(now.state?.latencyMs)],
    ["network", ms(now.latency.networkMs)],
    ["networkMax", ms(now.latency.networkMaxMs)],
    ["stopBegin", ms(now.state?.stop?.beginMs)],
    ["rest", ms(now.state?.stop?.restMs)],
  ] as const;
  return (
    <>
      <dl className="control__values">
        {rows.map(([name, value]) => (
          <div key={name}>
            <dt>{t(`latency.${name}`)}</dt>
            <dd>{value}</dd>
          </div>
        ))}
      </dl>
      <p className="quiet">{t("latency.means")}</p>
    </>
  );
}
