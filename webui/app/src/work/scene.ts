/** The live scene and its situation, without short transitions. */
import { useEffect, useMemo, useRef, useState } from "react";
import { useFamily, useConnectionState, useLive, useTopic } from "~/live/hooks";
import type { GloveTask, Outcome, ServiceHealth } from "~/live/messages";
import { useOwnStation } from "~/session/ownStation";
import { atStation, situationOf, type Scene, type Situation } from "./situation";

/** Situations that are shown only if they last: gaps between steps and short reconnections. */
const PASSING_MS = 800;
/** How long the check is shown before the next step slides in. */
const CHECK_MS = 1200;

const noServices: readonly ServiceHealth[] = [];

/** The live scene; at a station only its own gloves, worn by the person who has joined. */
export function useScene(chosen: string | null): Scene {
  const { isStation, station } = useOwnStation();
  const link = useConnectionState();
  const hasSnapshot = useLive().hasSnapshot && (!isStation || station !== null);
  const services = useTopic("services") ?? noServices;
  const gloves = useFamily("glove");
  const robots = useFamily("robot");
  const processes = useFamily("process");
  const definitions = useFamily("definition");
  return useMemo(
    () => {
      const scene = { link, hasSnapshot, services, gloves, robots, processes, definitions, chosen };
      return station === null ? scene : atStation(scene, station);
    },
    [link, hasSnapshot, services, gloves, robots, processes, definitions, chosen, station],
  );
}

/** Return the situation to show: short transitions are skipped, faults are shown at once. */
export function useSituation(scene: Scene): Situation {
  const situation = useMemo(() => situationOf(scene), [scene]);
  const [shown, setShown] = useState(situation);
  const newest = useRef(situation);
  const passing = mayPass(situation) && shown.kind !== situation.kind;
  if (!passing && shown !== situation) setShown(situation);
  useEffect(() => {
    newest.current = situation;
  });
  useEffect(() => {
    if (!passing) return;
    const timer = setTimeout(() => setShown(newest.current), PASSING_MS);
    return () => clearTimeout(timer);
  }, [passing]);
  return passing ? shown : situation;
}

function mayPass(situation: Situation): boolean {
  return situation.kind === "linkLost" || (situation.kind === "between" && situation.task === null);
}

export interface Answered {
  task: GloveTask;
  operator: string | null;
  outcome: Outcome;
}

/** Return the Task that was just answered, while its check mark is shown. */
export function useAnswered(situation: Situation, scene: Scene): Answered | null {
  const [last, setLast] = useState<GloveTask | null>(null);
  const [over, setOver] = useState<string | null>(null);
  const glove = "glove" in situation ? (scene.gloves.find((glove) => glove.glove === situation.glove.glove) ?? null) : null;
  const answered = glove?.answered ?? null;
  const isFresh = last !== null && answered?.task === last.id && over !== last.id;
  const task = situation.kind === "prompt" || situation.kind === "gloveLost" || situation.kind === "paused" ? situation.task : null;
  if (!isFresh && task !== null && task.id !== last?.id) setLast(task);
  const fresh = isFresh ? last.id : null;
  useEffect(() => {
    if (fresh === null) return;
    const timer = setTimeout(() => setOver(fresh), CHECK_MS);
    return () => clearTimeout(timer);
  }, [fresh]);
  return isFresh ? { task: last, operator: answered.operator, outcome: answered.outcome ?? "ok" } : null;
}
