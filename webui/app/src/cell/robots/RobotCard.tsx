/** A robot: its joints, motion, Task and gripper. */
import { lazy, Suspense } from "react";
import { useTranslation } from "react-i18next";
import { Card } from "~/design/Card";
import { percent as percentOf } from "~/design/numbers";
import { StatusBadge } from "~/design/StatusBadge";
import { deviceTone } from "~/design/states";
import { duration } from "~/design/times";
import { useTopicSelector, useTopic } from "~/live/hooks";
import { useRobotDescription } from "~/robot/description";
import { HandOver } from "~/robot/HandOver";
import { Gripper } from "./Gripper";
import { JointTable } from "./JointTable";
import { Limits } from "./Limits";
import "./RobotCard.css";

const Robot3d = lazy(() => import("~/robot3d/Robot3d"));

export function RobotCard({ robot }: { robot: string }) {
  const { t } = useTranslation(["system", "common"]);
  const state = useTopicSelector(`robot/${robot}`, (view) => view?.deviceState);
  const model = useTopicSelector(`robot/${robot}`, (view) => view?.model);
  const revision = useTopicSelector(`robot/${robot}`, (view) => view?.revision) ?? "";
  const query = useRobotDescription(robot, revision);
  return (
    <Card
      className="robot"
      title={model === undefined ? robot : `${robot} (${model})`}
      aside={state !== undefined && <StatusBadge tone={deviceTone[state]}>{t(`common:deviceState.${state}`)}</StatusBadge>}
    >
      <div className="robot__body">
        <div className="robot__view">
          <Suspense fallback={<p className="robot__loading quiet">{t("robot.loading3d")}</p>}>
            <Robot3d key={query.description?.revision} robot={robot} {...query} />
          </Suspense>
        </div>
        <div className="robot__facts">
          <Doing robot={robot} />
          <Confirmation robot={robot} />
          <Gripper robot={robot} />
          <Limits robot={robot} />
          <JointTable robot={robot} description={query.description} />
        </div>
      </div>
    </Card>
  );
}

function Confirmation({ robot }: { robot: string }) {
  const view = useTopic(`robot/${robot}`);
  return view === undefined ? null : <HandOver robot={view} />;
}

function Doing({ robot }: { robot: string }) {
  const { t, i18n } = useTranslation("system");
  const view = useTopic(`robot/${robot}`);
  const progress = view?.progress ?? null;
  const percent = percentOf(progress ?? 0, i18n.language);
  const remainingS = view?.remainingS ?? null;
  const operation = view?.operation ?? null;
  return (
    <section className="robot__doing">
      <h3>{operation === null ? t("robot.idle") : t(`robot.operation.${operation}`, { defaultValue: operation })}</h3>
      <div
        className="robot__progress"
        data-idle={progress === null || undefined}
        {...(progress === null
          ? { "aria-hidden": true }
          : { role: "progressbar", "aria-label": t("robot.progress"), "aria-valuenow": Math.round(progress * 100), "aria-valuetext": percent })}
      >
        <div style={{ width: `${(progress ?? 0) * 100}%` }} />
      </div>
      <p className="quiet">
        {progress === null
          ? t("robot.noTask")
          : remainingS === null
            ? percent
            : t("robot.remaining", { percent, remaining: duration(Math.round(remainingS) * 1000, i18n.language) })}
      </p>
    </section>
  );
}
