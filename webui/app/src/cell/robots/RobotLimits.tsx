/** What limits the speed of a robot, in full: each rule, the people who are bound to it, the sources it needs, and decisions about them. */
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { PersonView } from "~/api/generated/human-state";
import type { RobotLimitsView } from "~/api/generated/trajectory-tool";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import "~/design/Figures.css";
import { number, percent } from "~/design/numbers";
import { RelativeTime } from "~/design/RelativeTime";
import { useTopicSelector } from "~/live/hooks";
import { sentence } from "~/live/readable";
import { addresses } from "~/places/addresses";
import { MayNot } from "~/design/MayNot";
import { mayDo } from "~/session/session";
import { Limits } from "./Limits";
import "../objects/ObjectHistory.css";

const EVERY_MS = 1000;
const PEOPLE_EVERY_MS = 5000;

export default function RobotLimits({ robot }: { robot: string }) {
  const { t } = useTranslation("cell");
  const path = `robots/${encodeURIComponent(robot)}/limits`;
  const { value: limits, failure } = useServiceQuery<RobotLimitsView>("trajectory-tool", path, { intervalMs: EVERY_MS });
  return (
    <div className="history">
      <Card>
        <Limits robot={robot} />
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      </Card>
      {limits !== null && (
        <>
          <Rules limits={limits} />
          <Card title={t("limits.sources")}>
            <Names names={limits.limitSources} none={t("limits.noSources")} />
            <h3>{t("limits.peopleSensors")}</h3>
            <Names names={limits.peopleSensors} none={t("limits.noPeopleSensors")} />
          </Card>
        </>
      )}
      <People robot={robot} />
      {limits !== null && limits.decisions.length > 0 && <Decisions limits={limits} />}
    </div>
  );
}

function Rules({ limits }: { limits: RobotLimitsView }) {
  const { t, i18n } = useTranslation(["cell", "system"]);
  return (
    <Card title={t("limits.rules")}>
      <p>{t(`limits.mode.${limits.mode}`)}</p>
      {limits.rules.length === 0 ? (
        <p className="quiet">{t("limits.noRules")}</p>
      ) : (
        <table className="figures">
          <thead>
            <tr>
              <th scope="col">{t("limits.rule")}</th>
              <th scope="col">{t("limits.allows")}</th>
              <th scope="col">{t("limits.why")}</th>
            </tr>
          </thead>
          <tbody>
            {limits.rules.map((rule) => (
              <tr key={rule.rule}>
                <th scope="row">{t(`system:limit.rule.${rule.rule}`, { defaultValue: rule.rule })}</th>
                <td>
                  {percent(rule.fraction, i18n.language)}
                  {rule.maxSpeed !== null && ` · ${number(rule.maxSpeed * 1000, i18n.language, { maximumFractionDigits: 0 })} mm/s`}
                </td>
                <td>{sentence(rule.reason)}</td>
              </tr>
            ))}
          </tbody>
        </table>
      )}
    </Card>
  );
}

function Names({ names, none }: { names: readonly string[]; none: string }) {
  if (names.length === 0) return <p className="quiet">{none}</p>;
  return (
    <ul className="object-history">
      {names.map((name) => (
        <li key={name}>{name}</li>
      ))}
    </ul>
  );
}

/** The people whose body limits this robot, for those who may read health data. */
function People({ robot }: { robot: string }) {
  const { t, i18n } = useTranslation("cell");
  const isInstalled = useTopicSelector("services", (services) => services?.some(({ name }) => name === "human-state")) === true;
  const mayRead = mayDo("readHealthData");
  const { value: people, failure } = useServiceQuery<PersonView[]>("human-state", isInstalled && mayRead ? "people" : null, { intervalMs: PEOPLE_EVERY_MS });
  if (!isInstalled) return null;
  const bound = (people ?? []).flatMap(({ person, limit }) => (limit?.robots.some((other) => other.robot === robot) === true ? [{ person, limit }] : []));
  return (
    <Card title={t("limits.people")}>
      <MayNot permission="readHealthData" />
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {people !== null && bound.length === 0 && <p className="quiet">{t("limits.noPeople")}</p>}
      <ul className="object-history">
        {bound.map(({ person, limit }) => (
          <li key={person}>
            <Link href={addresses.health({ person })}>{person}</Link>
            <span>{t(limit.isStopped ? "limits.stopped" : "limits.fraction", { percent: percent(limit.fraction, i18n.language) })}</span>
          </li>
        ))}
      </ul>
    </Card>
  );
}

function Decisions({ limits }: { limits: RobotLimitsView }) {
  const { t } = useTranslation("cell");
  return (
    <Card title={t("limits.decisions")}>
      <ul className="object-history">
        {limits.decisions.map((decision) => (
          <li key={`${decision.at} ${decision.what}`}>
            <span className="object-history__name">{t("limits.decision", { name: decision.name, what: decision.what, reason: decision.reason })}</span>
            <span className="quiet small">
              <RelativeTime at={decision.at} isStop />
            </span>
          </li>
        ))}
      </ul>
    </Card>
  );
}
