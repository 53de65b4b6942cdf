/** Activity, posture and sleep position: now, and how long each held over the last day. */
import { useTranslation } from "react-i18next";
import type { HistoryDuration, PersonView, StateView } from "~/api/generated/human-state";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { duration, span } from "~/design/times";
import { pathOf, POSITIONS, SERVICE, trustOf, trustTone } from "./health";

const REFRESH_MS = 60_000;

export function ActivityCard({ person, state, silentS }: { person: PersonView; state: StateView | null; silentS: number }) {
  const { t, i18n } = useTranslation("health");
  const values = POSITIONS.flatMap((name) => state?.values.filter((value) => value.name === name) ?? []);
  return (
    <Card title={t("activity.title")} className="health__activity">
      {values.length === 0 && <p className="quiet">{t("activity.none")}</p>}
      <dl className="health__positions">
        {values.map((value) => {
          const trust = trustOf(value, silentS);
          return (
            <div key={value.name} data-trust={trust}>
              <dt>{t(`feature.${value.name}`)}</dt>
              <dd>
                <strong>{t(`text.${value.value}`, { defaultValue: String(value.value) })}</strong>{" "}
                {trust !== "valid" && <StatusBadge tone={trustTone[trust]}>{t(`trust.${trust}`)}</StatusBadge>} <span className="quiet small">{t("vital.age", { age: span(value.ageS + silentS, i18n.language) })}</span>
              </dd>
            </div>
          );
        })}
      </dl>
      {person.purposes.includes("history") ? (
        <>
          <Durations person={person.person} feature="activity" />
          <Durations person={person.person} feature="dailyActivity" />
          <Durations person={person.person} feature="sleepPosition" />
        </>
      ) : (
        <p className="quiet small">{t("history.off")}</p>
      )}
    </Card>
  );
}

function Durations({ person, feature }: { person: string; feature: "activity" | "dailyActivity" | "sleepPosition" }) {
  const { t, i18n } = useTranslation("health");
  const { value, failure } = useServiceQuery<HistoryDuration[]>(SERVICE, `${pathOf(person)}/history/${feature}/durations`, { intervalMs: REFRESH_MS });
  const rows = value ?? [];
  const most = rows[0]?.seconds ?? 0;
  if (failure !== null) return <ErrorMessage>{failure}</ErrorMessage>;
  if (rows.length === 0) return null;
  return (
    <table className="figures health__durations">
      <caption className="small quiet">{t(`activity.day.${feature}`)}</caption>
      <tbody>
        {rows.map(({ value: name, seconds }) => (
          <tr key={name}>
            <th scope="row">{t(`text.${name}`, { defaultValue: name })}</th>
            <td>{duration(seconds * 1000, i18n.language)}</td>
            <td aria-hidden className="health__bar">
              <svg viewBox="0 0 100 8" preserveAspectRatio="none">
                <rect width={(100 * seconds) / most} height={8} rx={1} />
              </svg>
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}
