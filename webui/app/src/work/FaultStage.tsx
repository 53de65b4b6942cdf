/** Full-page states that stop the work: an icon, a word, a colour and the remedy. */
import { CirclePause, CloudOff, HandHelping, Hourglass, OctagonX, ServerCrash, Users, WifiOff } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { localizedText } from "~/i18n/server";
import type { IncidentView, ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import { isSame } from "~/live/urn";
import { useMessageText } from "./messageText";
import { stepOf, type Situation } from "./situation";
import { FullPageState } from "./FullPageState";

export function FaultStage({ situation, choose }: { situation: Situation; choose: (glove: string) => void }) {
  const { t } = useTranslation(["work", "common"]);
  const messageText = useMessageText();
  switch (situation.kind) {
    case "connecting":
      return <FullPageState tone="neutral" icon={<Hourglass aria-hidden />} title={t("connecting.title")} />;
    case "paused":
      return (
        <FullPageState
          tone="attention"
          icon={<CirclePause aria-hidden />}
          title={t("paused")}
          means={messageText(situation.glove.message)}
          todo={t("waitingStep", { task: situation.task.description })}
        />
      );
    case "linkLost":
      return (
        <FullPageState tone="stop" icon={<CloudOff aria-hidden />} title={t("linkLost.title")} means={t("linkLost.means")} todo={t("linkLost.do")} />
      );
    case "serviceLost":
      return (
        <FullPageState
          tone="stop"
          icon={<ServerCrash aria-hidden />}
          title={t(`serviceLost.${situation.service}.title`)}
          means={t(`serviceLost.${situation.service}.means`)}
          todo={t("serviceLost.do")}
          detail={situation.detail}
        />
      );
    case "gloveLost":
      return (
        <FullPageState
          tone="stop"
          icon={<WifiOff aria-hidden />}
          title={t("gloveLost.title", { glove: situation.glove.glove })}
          means={t("gloveLost.means", { task: situation.task.description })}
          todo={t("gloveLost.do")}
        />
      );
    case "failed":
      return <Failed process={situation.process} />;
    case "incident":
      return <Stopped process={situation.process} incident={situation.incident} />;
    case "noGlove": {
      const glove = situation.chosen ?? "glove-1";
      return (
        <FullPageState
          tone="attention"
          icon={<HandHelping aria-hidden />}
          title={situation.chosen === null ? t("noGlove.title") : t("noGlove.titleOne", { glove })}
          means={t("noGlove.means")}
          todo={t("noGlove.do")}
        />
      );
    }
    case "chooseGlove":
      return (
        <FullPageState tone="accent" icon={<Users aria-hidden />} title={situation.unknown === null ? t("choose.title") : t("common:unknown.glove", { name: situation.unknown })} means={t("choose.means")}>
          {situation.gloves.map((glove) => (
            <Button key={glove.glove} size="large" onPress={() => choose(glove.glove)}>
              {t("by.choose", { name: glove.person === null ? glove.glove : `${glove.person} (${glove.glove})` })}
            </Button>
          ))}
        </FullPageState>
      );
    default:
      return null;
  }
}

/** A failed process: the report of a person, or the reason from the service. */
function Failed({ process }: { process: ProcessView }) {
  const { t } = useTranslation("work");
  const reported = useReported(process);
  return (
    <FullPageState
      tone="stop"
      icon={<OctagonX aria-hidden />}
      title={t("failed.title", { title: process.title })}
      means={reported ?? t("failed.reason", { reason: localizedText(process, "reason") ?? t("failed.unknown") })}
      todo={t("failed.do")}
      detail={t("failed.means")}
    />
  );
}

/** An incident: the step that cannot continue and the reason; other steps may continue. */
function Stopped({ process, incident }: { process: ProcessView; incident: IncidentView }) {
  const { t } = useTranslation("work");
  const reported = useReported(process, incident.task);
  const others = process.incidents.length - 1;
  const where = t("incident.where", { step: stepOf(incident) });
  const why = reported ?? t("incident.reason", { step: stepOf(incident), reason: localizedText(incident, "reason") ?? t("failed.unknown") });
  return (
    <FullPageState
      tone="stop"
      icon={<OctagonX aria-hidden />}
      title={reported === null ? t("incident.title", { title: process.title }) : where}
      means={why}
      todo={t("incident.do")}
      detail={others > 0 ? `${t("incident.means")} ${t("incident.others", { count: others })}` : t("incident.means")}
    />
  );
}

/** Return the report of a person with which a Task has failed: the Task `of`, or the last one without it. */
function useReported(process: ProcessView, of: string | null = null): string | null {
  const { t } = useTranslation("work");
  const failed = process.tasks.filter(({ status, outputParameters }) => status === "failed" && isReport(outputParameters?.["outcome"]));
  const task: TaskView | undefined = of === null ? failed.at(-1) : failed.find(({ id }) => isSame(id, of));
  const output = task?.outputParameters;
  if (task === undefined || output == null) return null;
  const { outcome, note, operator } = output;
  const who = typeof operator === "string" ? operator : "";
  const what = t(`outcome.${outcome === "problem" ? "problem" : "notGood"}`);
  const messageText = who === "" ? t("reported.what", { what, task: task.name }) : t("reported.by", { what, who, task: task.name });
  return typeof note === "string" && note !== "" ? `${messageText} ${t("reported.note", { note })}` : messageText;
}

function isReport(outcome: unknown): boolean {
  return outcome === "notGood" || outcome === "problem";
}
