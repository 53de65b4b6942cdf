/** The speed limit that follows from the body, its reason, the robots that have it, and the end of a stop. */
import { RotateCcw } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { LimitView, PersonView } from "~/api/generated/human-state";
import { errorText, requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { number, percent } from "~/design/numbers";
import { StatusBadge } from "~/design/StatusBadge";
import { addresses } from "~/places/addresses";
import { mayDo } from "~/session/session";
import { useWithName } from "~/shell/userName";
import { limitTone, pathOf, reasonOf, SERVICE } from "./health";
import { BindRobot, UnbindRobot } from "./RobotBinding";

export function LimitCard({ person, limit, onChange }: { person: PersonView; limit: LimitView; onChange: () => void }) {
  const { t, i18n } = useTranslation("health");
  const { withName, question } = useWithName();
  const [failure, setFailure] = useState<string | null>(null);
  const reason = reasonOf(limit);
  const bpm = (value: number) => number(value, i18n.language, { maximumFractionDigits: 0 });
  const reset = () => {
    setFailure(null);
    void withName((name) => requestService(SERVICE, `${pathOf(person.person)}/limit/reset`, { method: "POST", json: { name } }).then(onChange)).catch((error: unknown) => setFailure(errorText(error)));
  };
  return (
    <Card title={t("limit.title")} className="health__limit" aside={<StatusBadge tone={limitTone(limit)}>{t(limit.isStopped ? "limit.stopped" : limit.fraction < 1 ? "limit.slowed" : "limit.full")}</StatusBadge>}>
      <p className="health__fraction" data-stopped={limit.isStopped || undefined}>
        <output>{percent(limit.fraction, i18n.language)}</output> <span className="quiet small">{t("limit.ofSpeed")}</span>
      </p>
      <p>{reason.key === "other" ? reason.text : t(`limit.reason.${reason.key}`, { seconds: reason.seconds })}</p>
      {limit.heldBy.length > 0 && <p>{t("limit.heldBy", { sensors: limit.heldBy.join(", ") })}</p>}
      <p className="quiet small">{t("limit.curve", { free: bpm(limit.freeBpm), strained: bpm(limit.strainedBpm), least: percent(limit.leastFraction, i18n.language) })}</p>
      {limit.robots.length === 0 ? (
        <p className="quiet small">{t("limit.noRobot")}</p>
      ) : (
        <ul className="health__list">
          {limit.robots.map(({ robot, problem }) => (
            <li key={robot}>
              <Link href={addresses.robot(robot, "control")}>{robot}</Link>
              <StatusBadge tone={problem === "" ? "ok" : "attention"}>{problem === "" ? t("limit.received") : t("limit.notReceived", { problem })}</StatusBadge>
              {mayDo("moveRobots") && <UnbindRobot person={person} robot={robot} onChange={onChange} />}
            </li>
          ))}
        </ul>
      )}
      {mayDo("moveRobots") && <BindRobot person={person} bound={limit.robots.map(({ robot }) => robot)} onChange={onChange} />}
      {limit.isStopped && (
        <>
          <p className="small">{t("limit.resetMeans")}</p>
          <Button kind="main" icon={<RotateCcw aria-hidden size={18} />} onPress={reset}>
            {t("limit.reset")}
          </Button>
        </>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {question}
      <p className="quiet small">{t("limit.noStop")}</p>
    </Card>
  );
}
