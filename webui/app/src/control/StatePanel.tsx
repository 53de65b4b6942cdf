/** What the robot does, why it stopped, and the delay of the control. */
import { useTranslation } from "react-i18next";
import { Card } from "~/design/Card";
import { number } from "~/design/numbers";
import { StatusBadge } from "~/design/StatusBadge";
import type { Stopped } from "./connection";
import { DelayChart } from "./DelayChart";
import type { Control } from "./useControl";

export function StatePanel({ control: { connection, now }, isOld }: { control: Control; isOld: boolean }) {
  const { t, i18n } = useTranslation("control");
  const language = i18n.language;
  const ms = (value: number | null | undefined) => (value == null ? "–" : `${number(value, language, { maximumFractionDigits: 1 })} ms`);
  const { state, latency, stops } = now;
  const clock = new Intl.DateTimeFormat(language, { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" });
  const network = ms(latency.networkMs);
  const most = ms(latency.networkMaxMs);
  return (
    <Card className="control__panel control__panel--state" title={t("panel.state")} aside={<State now={now} isOld={isOld} />}>
      <div className="state">
        <div className="state__stops">
          <h3>{t("stops.title")}</h3>
          {stops.length === 0 ? (
            <p className="quiet">{t("stops.none")}</p>
          ) : (
            <ol>
              {stops.map(({ at, why }) => (
                <li key={at}>
                  <time dateTime={new Date(at).toISOString()}>{clock.format(at)}</time> <span>{t(`stopped.${why}`)}</span>
                </li>
              ))}
            </ol>
          )}
          {(state?.mix ?? 0) > 0 && <p>{t("stops.shared", { share: number(state?.mix ?? 0, language, { maximumFractionDigits: 2 }) })}</p>}
        </div>
        <div className="delay">
          <DelayChart connection={connection} label={t("latency.chart", { network, most })} />
          <dl className="control__values" title={t("latency.means")}>
            <div className="delay__network">
              <dt>{t("latency.network")}</dt>
              <dd>{network}</dd>
            </div>
            <div className="delay__robot">
              <dt>{t("latency.robot")}</dt>
              <dd>{ms(state?.latencyMs)}</dd>
            </div>
            <div>
              <dt>{t("latency.networkMax")}</dt>
              <dd>{most}</dd>
            </div>
            <div>
              <dt>{t("latency.rest")}</dt>
              <dd>{ms(state?.stop?.restMs)}</dd>
            </div>
          </dl>
        </div>
      </div>
    </Card>
  );
}

function State({ now, isOld }: { now: Control["now"]; isOld: boolean }) {
  const { t } = useTranslation("control");
  if (isOld) return <StatusBadge tone="stop">{t("state.old")}</StatusBadge>;
  if (now.phase !== "on" || now.state === null) return null;
  if (now.state.moves) return <StatusBadge tone="attention">{t("state.moves")}</StatusBadge>;
  return <StatusBadge tone={isUnwanted(now.stopped) ? "attention" : "ok"}>{now.stopped === null ? t("state.rests") : t(`stopped.${now.stopped}`)}</StatusBadge>;
}

/** Whether the motion ended although the person held the control. */
function isUnwanted(stopped: Stopped | null): boolean {
  return stopped === "slow" || stopped === "limit" || stopped === "fault";
}
