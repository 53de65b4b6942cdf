/** The operator's page: the one thing that counts now, large, and one act that answers it. */
import { useEffect } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Problem } from "~/design/Problem";
import { useTopic } from "~/live/hooks";
import type { Activity, ProcessView, RobotView } from "~/live/messages";
import { useQuery } from "~/route/query";
import { useWithName } from "~/shell/who";
import { AskedStage, DoneStage } from "./AskedStage";
import { OfferStage } from "./OfferStage";
import { BetweenStage, RobotStage } from "./RobotStage";
import { useAnswered, useScene, useSituation, type Answered } from "./scene";
import { isSame, latest, type Scene, type Situation } from "./situation";
import { StatusStrip } from "./StatusStrip";
import { Trouble } from "./Trouble";
import { useAct, type Acting } from "./useAct";
import { useOperatorActs, type OperatorActs } from "./useOperatorActs";
import { useOperatorKeys } from "./useOperatorKeys";
import "./WorkPage.css";

export default function WorkPage() {
  const [chosen, choose] = useQuery("glove");
  const scene = useScene(chosen === "" ? null : chosen);
  const situation = useSituation(scene);
  const answered = useAnswered(situation, scene);
  const only = chosen === "" && "glove" in situation ? situation.glove.glove : "";
  useEffect(() => {
    // Who works here goes on working when another glove joins.
    if (only !== "") choose(only);
  }, [only, choose]);
  const acting = useAct();
  const { withName, question } = useWithName("large");
  const acts = useOperatorActs(scene, situation, acting, withName);
  const step = answered === null ? stepOf(situation) : `done ${answered.task.id}`;
  useOperatorKeys(answered === null ? acts : { ...acts, main: null, complete: null }, step);
  return (
    <div className="work" data-situation={answered === null ? situation.kind : "answered"}>
      <StatusStrip
        glove={"glove" in situation ? situation.glove : null}
        robot={robotOf(situation, scene)}
        process={shownProcess(situation, scene)}
        pause={acts.pause}
        busy={acting.busy}
        unknown={situation.kind === "linkLost" || situation.kind === "connecting"}
        onChange={scene.gloves.length > 1 && chosen !== "" ? () => choose("") : null}
      />
      <section className="work__stage" key={step}>
        <Stage situation={situation} answered={answered} acts={acts} acting={acting} choose={choose} />
      </section>
      <Foot situation={situation} answered={answered} acts={acts} acting={acting} />
      {question}
    </div>
  );
}

interface StageProps {
  situation: Situation;
  answered: Answered | null;
  acts: OperatorActs;
  acting: Acting;
  choose: (glove: string) => void;
}

function Stage({ situation, answered, acts, acting, choose }: StageProps) {
  if (answered !== null && "glove" in situation) {
    return <DoneStage glove={situation.glove} task={answered.task} operator={answered.operator} />;
  }
  switch (situation.kind) {
    case "asked":
      return <AskedStage glove={situation.glove} task={situation.task} paused={false} answerWaits={situation.answerWaits} />;
    case "paused":
      return <AskedStage glove={situation.glove} task={situation.task} paused answerWaits={false} />;
    case "robot":
      return <RobotStage process={situation.process} task={situation.task} robot={situation.robot} />;
    case "between":
      return <BetweenStage task={situation.task} />;
    case "idle":
    case "completed":
      return (
        <OfferStage
          glove={situation.glove}
          startable={situation.startable}
          completed={situation.kind === "completed" ? situation.process : null}
          acting={acting}
          onStart={(definition) => acts.start?.(definition)}
        />
      );
    default:
      return <Trouble situation={situation} acts={acts} acting={acting} choose={choose} />;
  }
}

function Foot({ situation, answered, acts, acting }: Omit<StageProps, "choose">) {
  const { t } = useTranslation("work");
  const where = useTopic("cell")?.emergencyStop ?? t("stop");
  const isTrouble = !["asked", "paused", "robot", "between", "idle", "completed"].includes(situation.kind);
  const act = isTrouble || answered !== null ? null : acts.main;
  return (
    <section className="work__foot">
      <div className="work__foot-words">
        {acting.failure !== null ? <Problem>{acting.failure}</Problem> : <Next situation={situation} />}
        <p className="work__safety">{t("safety", { where })}</p>
      </div>
      {act !== null && (
        <Button size="large" kind={situation.kind === "asked" ? "plain" : "main"} isDisabled={acting.busy} onPress={act.do}>
          {act.name}
        </Button>
      )}
    </section>
  );
}

function Next({ situation }: { situation: Situation }) {
  const { t } = useTranslation("work");
  if (!("next" in situation) || !("process" in situation) || situation.process === null) return null;
  return <p className="work__next">{wordsOfNext(situation.next)}</p>;

  function wordsOfNext(next: Activity | null): string {
    if (next === null) return t("nextUnknown");
    return next.lane === null ? t("next", { name: next.name }) : t("nextBy", { name: next.name, lane: next.lane });
  }
}

function robotOf(situation: Situation, scene: Scene): RobotView | null {
  if (situation.kind === "robot") return situation.robot;
  const process = shownProcess(situation, scene);
  const taking = scene.robots.find((robot) => process?.tasks.some((task) => task.involves.some((one) => isSame(one, robot.device))));
  return taking ?? scene.robots[0] ?? null;
}

function shownProcess(situation: Situation, scene: Scene): ProcessView | null {
  if ("process" in situation) return situation.process;
  return situation.kind === "idle" ? null : latest(scene.processes.filter(({ endedAt }) => endedAt === null));
}

/** What the step is called: another one slides in, the same one stays where it is. */
function stepOf(situation: Situation): string {
  switch (situation.kind) {
    case "asked":
    case "paused":
      return `asked ${situation.task.id}`;
    case "robot":
      return `robot ${situation.task.id}`;
    case "completed":
    case "failed":
      return `${situation.kind} ${situation.process.id}`;
    default:
      return situation.kind;
  }
}

