/** The operator's page: the present situation and its actions. */
import { History, MonitorCog, OctagonAlert } from "lucide-react";
import { useEffect, useLayoutEffect, useRef, useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { PinDialog } from "~/design/PinDialog";
import { useProcessTexts, useTopic } from "~/live/hooks";
import type { NextActivity, ProcessView } from "~/api/generated/task-orchestrator";
import type { RobotView } from "~/live/messages";
import { isSame } from "~/live/urn";
import { useQueryParameter } from "~/route/queryParameter";
import { AccountMenu } from "~/session/AccountMenu";
import { useSession } from "~/session/session";
import { useKiosk } from "~/shell/kiosk";
import { useWithName } from "~/shell/userName";
import { useParticipantMode } from "~/study/participantMode";
import { givePin } from "./actions";
import { PromptStage, DoneStage } from "./PromptStage";
import { ActionBar } from "./ActionBar";
import { isAsked, mayRest, useDimmed, useWakeLock } from "./awake";
import { KioskExit } from "./Kiosk";
import { PastSteps } from "./PastSteps";
import { StartStage } from "./StartStage";
import { BetweenStage, RobotStage } from "./RobotStage";
import { ReportPanel, type ReportedOutcome } from "./ReportPanel";
import { useAnswered, useScene, useSituation, type Answered } from "./scene";
import { latest, type Scene, type Situation } from "./situation";
import { useStation } from "./station";
import { StationPanel } from "./StationPanel";
import { StatusStrip } from "./StatusStrip";
import { FaultStage } from "./FaultStage";
import { useAction, type ActionState } from "./useAction";
import { useFit } from "./useFit";
import { useOperatorActions, type OperatorActions } from "./useOperatorActions";
import "./WorkPage.css";

export default function WorkPage() {
  const [chosen, choose] = useQueryParameter("glove");
  const scene = useScene(chosen === "" ? null : chosen);
  const situation = useSituation(scene);
  const answered = useAnswered(situation, scene);
  const only = chosen === "" && "glove" in situation ? situation.glove.glove : "";
  useEffect(() => {
    // Keep the glove of this page when another one connects.
    if (only !== "") choose(only);
  }, [only, choose]);
  const isParticipant = useParticipantMode() !== null;
  const acting = useAction();
  const { withName, question } = useWithName("large");
  const [asksPin, setAsksPin] = useState(false);
  const acts = useOperatorActions(scene, situation, acting, withName, () => setAsksPin(true));
  const step = answered === null ? stepOf(situation) : `done ${answered.task.id}`;
  const [reporting, report] = useState<ReportedOutcome | null>(null);
  const [showsStation, setShowsStation] = useState(false);
  /** The step that ran when the finished ones were opened: they close when another begins. */
  const [looksBackFrom, lookBackFrom] = useState<string | null>(null);
  const process = shownProcess(situation, scene);
  const hasPast = process?.tasks.some(({ endedAt }) => endedAt !== null) === true;
  const isKiosk = useKiosk() && !isParticipant;
  const isStation = useSession().user?.isStation === true;
  useWakeLock(isKiosk || isAsked(situation));
  const isDimmed = useDimmed(isKiosk && mayRest(situation), handOf(scene));
  const { minPx } = useStation();
  useLayoutEffect(() => {
    // On the root element, because dialogs are outside of the page.
    document.documentElement.style.setProperty("--read", `${minPx}px`);
  }, [minPx]);
  const page = useRef<HTMLDivElement>(null);
  // Load `hand` with the page: a panel that loads it later would suspend the page and lose the focus.
  const { t, i18n } = useTranslation(["work", "hand"]);
  useFit(page, `${step} ${i18n.language} ${minPx}`);
  const shown = answered === null ? situation.kind : "answered";
  return (
    <div className="work">
      <div className="work__page" data-situation={shown} ref={page}>
        <StatusStrip
          glove={"glove" in situation ? situation.glove : null}
          robot={robotOf(situation, scene)}
          process={process}
          pause={acts.pause}
          busy={acting.busy}
          unknown={situation.kind === "linkLost" || situation.kind === "connecting"}
          account={isKiosk && isStation ? <AccountMenu /> : null}
          onChange={!isParticipant && scene.gloves.length > 1 && chosen !== "" ? () => choose("") : null}
        />
        <section className="work__stage" key={step}>
          <Stage situation={situation} answered={answered} acts={acts} acting={acting} choose={choose} />
        </section>
        <section className="work__footer">
          {acting.failure !== null && <ErrorMessage>{acting.failure}</ErrorMessage>}
          <div className="work__actions">
            <Next situation={situation} />
            {answered === null && <ActionBar situation={situation} acts={acts} acting={acting} report={report} />}
          </div>
          <div className="work__base">
            <Safety />
            {process !== null && hasPast && (
              <Button size="large" label={t("past.title")} icon={<History aria-hidden size="1em" />} onPress={() => lookBackFrom(step)}>
                <span className="work__word">{t("past.open")}</span>
              </Button>
            )}
            <Button kind="quiet" size="large" label={t("station.title")} icon={<MonitorCog aria-hidden size="1em" />} onPress={() => setShowsStation(true)} />
          </div>
        </section>
      </div>
      {acts.report !== null && reporting !== null && "task" in situation && (
        <ReportPanel outcome={reporting} task={situation.task?.description ?? ""} onReport={acts.report} onClose={() => report(null)} />
      )}
      {asksPin && "glove" in situation && situation.glove.task?.needsPin === true && (
        <PinDialog onClose={() => setAsksPin(false)} onPin={(pin) => givePin(situation.glove.glove, situation.glove.task?.id, pin)}>
          <p>{situation.glove.task.description}</p>
        </PinDialog>
      )}
      {process !== null && looksBackFrom === step && (
        <PastSteps process={process} present={"task" in situation ? (situation.task?.description ?? null) : null} onClose={() => lookBackFrom(null)} />
      )}
      {isKiosk && <KioskExit />}
      {isDimmed && (
        <div className="work__dim" role="status" onPointerDown={(event) => event.stopPropagation()}>
          <p>{t("kiosk.wake")}</p>
        </div>
      )}
      {showsStation && <StationPanel onClose={() => setShowsStation(false)} />}
      {question}
    </div>
  );
}

interface StageProps {
  situation: Situation;
  answered: Answered | null;
  acts: OperatorActions;
  acting: ActionState;
  choose: (glove: string) => void;
}

function Stage({ situation, answered, acts, acting, choose }: StageProps) {
  if (answered !== null && "glove" in situation) {
    return <DoneStage glove={situation.glove} {...answered} />;
  }
  switch (situation.kind) {
    case "prompt":
      return <PromptStage glove={situation.glove} task={situation.task} answerWaits={situation.answerWaits} />;
    case "robot":
      return <RobotStage process={situation.process} task={situation.task} robot={situation.robot} />;
    case "between":
      return <BetweenStage task={situation.task} />;
    case "idle":
    case "completed":
      return (
        <StartStage
          glove={situation.glove}
          startable={situation.startable}
          completed={situation.kind === "completed" ? situation.process : null}
          acting={acting}
          onStart={(definition) => acts.start?.(definition)}
        />
      );
    default:
      return <FaultStage situation={situation} choose={choose} />;
  }
}

function Safety() {
  const { t } = useTranslation("work");
  const where = useTopic("cell")?.emergencyStop ?? t("stop");
  return (
    <p className="work__safety">
      <OctagonAlert aria-hidden /> <span>{t("safety", { where })}</span>
    </p>
  );
}

function Next({ situation }: { situation: Situation }) {
  const { t } = useTranslation("work");
  const texts = useProcessTexts();
  if (!("next" in situation) || !("process" in situation) || situation.process === null) return <span />;
  const { next } = situation;
  const [following] = situation.process.afterNext;
  return (
    <p className="work__next">
      <span>{next === null ? t("nextUnknown") : words(next, "next")}</span>
      {next !== null && following !== undefined && <span className="work__then">{words(following, "then")}</span>}
    </p>
  );

  function words({ name, lane }: NextActivity, when: "next" | "then"): string {
    return lane === null ? t(when, { name }) : t(`${when}By`, { name, lane: texts.say(lane) });
  }
}

/** What a worn glove shows: it changes when a hand moves. */
function handOf({ gloves, chosen }: Scene): string {
  return gloves.filter(({ glove }) => chosen === null || glove === chosen).map(({ glove, connected, states }) => `${glove} ${connected} ${states}`).join();
}

function robotOf(situation: Situation, scene: Scene): RobotView | null {
  if (situation.kind === "robot") return situation.robot;
  const process = shownProcess(situation, scene);
  const taking = scene.robots.find((robot) => process?.tasks.some((task) => task.involves.some((resource) => isSame(resource, robot.device))));
  return taking ?? scene.robots[0] ?? null;
}

function shownProcess(situation: Situation, scene: Scene): ProcessView | null {
  if ("process" in situation) return situation.process;
  return situation.kind === "idle" ? null : latest(scene.processes.filter(({ endedAt }) => endedAt === null));
}

/** The key of the step: a new key slides in. */
function stepOf(situation: Situation): string {
  switch (situation.kind) {
    case "prompt":
      return `prompt ${situation.task.id}`;
    case "robot":
      return `robot ${situation.task.id}`;
    case "completed":
    case "failed":
      return `${situation.kind} ${situation.process.id}`;
    case "incident":
      return `incident ${situation.process.id} ${situation.incident.token} ${situation.incident.since}`;
    default:
      return situation.kind;
  }
}

