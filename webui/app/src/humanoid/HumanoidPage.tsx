/** Humanoid: the robot live, the therapist's throws, walks and sessions, and what engineers look at. */
import { Bot } from "lucide-react";
import { lazy, Suspense, useCallback, useMemo, useState, useSyncExternalStore } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { FramesView, HumanoidView, RecordingView } from "~/api/generated/whole-body-control";
import { errorText, requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Card } from "~/design/Card";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Loading } from "~/design/Loading";
import { StatusBadge } from "~/design/StatusBadge";
import { addresses } from "~/places/addresses";
import { mayDo } from "~/session/session";
import { ForcesCard, ModelCard, SolverCard, StackCard } from "./EngineCards";
import { GainsCard } from "./GainsCard";
import type { DocumentSource } from "./Humanoid3d";
import { inFrame, SERVICE, type HumanoidModel, type Place } from "./humanoid";
import { LimitsCard } from "./LimitsCard";
import { HumanoidLive } from "./liveState";
import { modeTone, throttled } from "./snapshots";
import { MotionCard } from "./MotionCard";
import { RecordingsCard, ReplayBar } from "./RecordingsCard";
import { Replay } from "./replay";
import { SessionCard, SessionsCard } from "./SessionCard";
import { StopBar } from "./StopBar";
import "./HumanoidPage.css";

const Humanoid3d = lazy(() => import("./Humanoid3d"));
const MODELS_EVERY_MS = 10_000;
/** The figures of the panels change less often than the picture. */
const PANELS_EVERY_MS = 200;
const FIRST_TARGET: Place = [0.8, 0, 0.5];

export default function HumanoidPage() {
  const { t } = useTranslation(["humanoid", "health", "system", "common"]);
  const { value: humanoids, failure } = useServiceQuery<HumanoidView[]>(SERVICE, "humanoids", { intervalMs: MODELS_EVERY_MS });
  const shown = humanoids?.find(({ name }) => name !== null) ?? null;
  return (
    <div className="humanoid">
      {failure !== null && <ErrorMessage act={<Link href={addresses.services()}>{t("health:toSystem")}</Link>}>{failure}</ErrorMessage>}
      {shown === null ? (
        <>
          <h1>{t("common:pages.exercises")}</h1>
          {humanoids === null ? failure === null && <Loading /> : <EmptyState icon={<Bot aria-hidden size={32} />} title={t("none")} />}
        </>
      ) : (
        <Humanoid key={shown.model} humanoid={shown} />
      )}
    </div>
  );
}

interface Replayed {
  replay: Replay;
  name: string;
}

function Humanoid({ humanoid }: { humanoid: HumanoidView }) {
  const { t } = useTranslation(["humanoid", "common", "humanoidVr"]);
  const { value: model } = useServiceQuery<HumanoidModel>(SERVICE, "model");
  const { value: urdf } = useServiceQuery<string>(SERVICE, "model/urdf");
  const live = useMemo(() => new HumanoidLive(), []);
  const panels = useMemo(() => throttled(live, PANELS_EVERY_MS), [live]);
  const { phase, document } = useSyncExternalStore(panels.subscribe, panels.snapshot);
  const [replayed, setReplayed] = useState<Replayed | null>(null);
  const [replayFailure, setReplayFailure] = useState<string | null>(null);
  const source: DocumentSource = replayed?.replay ?? live;
  const figures = useMemo(() => throttled(source, PANELS_EVERY_MS), [source]);
  const { document: shown } = useSyncExternalStore(figures.subscribe, figures.snapshot);
  const onReplay = (recording: RecordingView) => {
    setReplayFailure(null);
    const fetch = (fromS: number) => requestService<FramesView>(SERVICE, `recordings/${recording.id}/frames?from=${fromS}`);
    const replay = new Replay(fetch, (error) => setReplayFailure(errorText(error)));
    setReplayed({ replay, name: recording.label === "" ? t("recordings.untitled") : recording.label });
  };
  const [target, setTarget] = useState<Place>(FIRST_TARGET);
  const isFree = document?.session == null || document.session.state === "ended";
  const mayThrow = replayed === null && document?.behaviour === "juggling" && isFree && mayDo("moveRobots");
  const onPick = useCallback(
    (place: Place) => {
      const stance = live.snapshot().document?.stance ?? null;
      if (stance !== null) setTarget(inFrame(stance, place));
    },
    [live],
  );
  const name = humanoid.name ?? humanoid.model;
  const mode = document?.fault !== null && document !== null ? "fault" : (document?.mode ?? "unknown");
  return (
    <>
      <header className="humanoid__head">
        <h1>{t("common:pages.exercises")}</h1>
        <p className="quiet">
          {name} · {t("simulated", { model: humanoid.model })}
        </p>
        <StatusBadge tone={phase === "open" ? modeTone(mode) : "attention"}>{phase === "open" ? t(`mode.${mode}`) : t(`link.${phase}`)}</StatusBadge>
        <Link href={addresses.humanoidInVr()}>{t("humanoidVr:title")}</Link>
      </header>
      <p className="small quiet">{t("notSafe")}</p>
      <div className="humanoid__body">
        <div className="humanoid__top">
          <Card className="humanoid__view" title={t(replayed === null ? "view" : "recordings.replay")}>
            <div className="humanoid__stage">
              {model === null || urdf === null ? (
                <Loading />
              ) : (
                <Suspense fallback={<Loading />}>
                  <Humanoid3d name={name} urdf={urdf} model={model} source={source} onPick={mayThrow ? onPick : null} target={mayThrow ? target : null} />
                </Suspense>
              )}
            </div>
            <p className="humanoid__legend small quiet">{t(mayThrow ? "legendThrow" : "legend")}</p>
            {replayed !== null && <ReplayBar replay={replayed.replay} name={replayed.name} failure={replayFailure} onEnd={() => setReplayed(null)} />}
          </Card>
          {document !== null && (
            <div className="humanoid__side">
              {mayDo("performTasks") && <SessionCard document={document} behaviours={humanoid.behaviours} />}
              {mayDo("moveRobots") && <MotionCard document={document} behaviours={humanoid.behaviours} target={target} onTarget={setTarget} />}
              <LimitsCard document={document} />
            </div>
          )}
        </div>
        {shown !== null && model !== null && (
          <div className="humanoid__engine">
            <StackCard document={shown} />
            <SolverCard document={shown} />
            <ForcesCard document={shown} massKg={model.massKg} />
            <div className="humanoid__wide">
              <GainsCard document={shown} model={model} />
            </div>
            <div className="humanoid__wide">
              <ModelCard document={shown} model={model} />
            </div>
          </div>
        )}
        <div className="humanoid__wide">
          <SessionsCard />
        </div>
        <div className="humanoid__wide">
          <RecordingsCard onReplay={onReplay} />
        </div>
      </div>
      <StopBar document={document} />
    </>
  );
}
