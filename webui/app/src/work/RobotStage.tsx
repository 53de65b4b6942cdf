/** A robot works: its operation, progress and remaining time, so that nobody reaches into the cell. */
import { Bot, Hourglass, OctagonAlert } from "lucide-react";
import { ProgressBar } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { useNow } from "~/live/clock";
import type { ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import type { RobotView } from "~/live/messages";
import { isSame } from "~/live/urn";
import { HandOver } from "~/robot/HandOver";
import { secondsLeft } from "./time_left";
import "./RobotStage.css";

export function RobotStage({ process, task, robot }: { process: ProcessView; task: TaskView; robot: RobotView | null }) {
  const { t, i18n } = useTranslation("work");
  const now = useNow();
  const atIt = robot !== null && isSame(robot.task, task.id) ? robot : null;
  const named = task.workParameters["operation"];
  const operation = typeof named === "string" ? named : (atIt?.operation ?? "");
  const does = operation !== "" && i18n.exists(`work:robot.does.${operation}`) ? t(`robot.does.${operation}`) : (task.description ?? task.name);
  const left = secondsLeft(atIt, task, process.elements[task.element], now);
  const paused = task.status === "paused";
  return (
    <>
      <div className="robot-turn">
        <Bot aria-hidden strokeWidth={1.25} />
      </div>
      <div className="work__text">
        <h1 className="work__task work__task--large">{does}</h1>
        <p className="work__left" role="timer">
          {paused ? t("paused") : left === null ? t("robot.leftUnknown") : t("robot.left", { seconds: left })}
        </p>
        <ProgressBar className="robot-turn__bar" aria-label={t("robot.progress")} value={100 * (atIt?.progress ?? 0)}>
          {({ percentage = 0 }) => <div className="robot-turn__done" style={{ transform: `scaleX(${percentage / 100})` }} />}
        </ProgressBar>
        {atIt?.awaitsConfirmation === true ? (
          <HandOver robot={atIt} />
        ) : (
          <p className="robot-turn__out">
            <OctagonAlert aria-hidden /> {t("robot.keepOut")}
          </p>
        )}
        <p className="work__message">{paused ? t("robot.paused") : task.status === "pending" ? t("robot.waiting") : task.name}</p>
      </div>
    </>
  );
}

/** No Task for this screen: the next step is being prepared, or another person works on it. */
export function BetweenStage({ task }: { task: TaskView | null }) {
  const { t } = useTranslation("work");
  return (
    <>
      <div className="robot-turn robot-turn--calm">
        <Hourglass aria-hidden strokeWidth={1.25} />
      </div>
      <div className="work__text" role="status">
        <h1 className="work__task work__task--large">{t(task === null ? "between.title" : "between.other")}</h1>
        <p className="work__message">{task === null ? t("between.next") : (task.description ?? task.name)}</p>
      </div>
    </>
  );
}
