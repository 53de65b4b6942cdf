/**
* The situation: what the operator at this screen has to know now, derived from the live state.
 *
* In this order: faults, the Task for the hand, the robot's work, the processes that can be started. Without
* timers and rendering.
 */
import type { StationView } from "~/api/generated/accounts";
import type { DefinitionView, IncidentView, NextActivity, ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import type { GloveTask, GloveView, RobotView, ServiceHealth } from "~/live/messages";
import type { ConnectionState } from "~/live/store";
import { isSame } from "~/live/urn";

export interface Scene {
  link: ConnectionState;
  /** Whether a snapshot was received since the page was opened. */
  hasSnapshot: boolean;
  services: readonly ServiceHealth[];
  gloves: readonly GloveView[];
  robots: readonly RobotView[];
  processes: readonly ProcessView[];
  definitions: readonly DefinitionView[];
  /** The glove in the URL of the page. */
  chosen: string | null;
}

export type NeededService = "context-broker" | "task-orchestrator" | "gesture-controller" | "trajectory-tool";

export interface Prompt {
  glove: GloveView;
  task: GloveTask;
  process: ProcessView | null;
  next: NextActivity | null;
}

export interface Offer {
  /** Definitions without required parameters; the first is the main action. */
  startable: readonly DefinitionView[];
  glove: GloveView;
}

export type Situation =
  | { kind: "connecting" }
  | { kind: "linkLost" }
  | { kind: "serviceLost"; service: NeededService; detail: string | null }
  | { kind: "noGlove"; chosen: string | null }
  | { kind: "chooseGlove"; gloves: readonly GloveView[]; unknown: string | null }
  | ({ kind: "gloveLost" } & Prompt)
  | ({ kind: "paused" } & Prompt)
  | ({ kind: "prompt"; answerWaits: boolean } & Prompt)
  | { kind: "robot"; glove: GloveView; process: ProcessView; task: TaskView; robot: RobotView | null; next: NextActivity | null }
  | { kind: "between"; glove: GloveView; process: ProcessView; task: TaskView | null; next: NextActivity | null }
  | { kind: "incident"; glove: GloveView; process: ProcessView; incident: IncidentView }
  | ({ kind: "failed"; process: ProcessView } & Offer)
  | ({ kind: "completed"; process: ProcessView } & Offer)
  | ({ kind: "idle" } & Offer);

/** Return the present situation. */
export function situationOf(scene: Scene): Situation {
  if (!scene.hasSnapshot) return scene.link === "lost" ? { kind: "linkLost" } : { kind: "connecting" };
  if (scene.link === "lost") return { kind: "linkLost" };
  const lost = (service: NeededService) => lostService(scene.services, service);
  const away = lost("context-broker") ?? lost("gesture-controller");
  if (away !== null) return away;
  const glove = gloveOf(scene);
  if (glove === null) {
    return scene.gloves.length > 0 && (scene.chosen === null || scene.gloves.length > 1)
      ? { kind: "chooseGlove", gloves: scene.gloves, unknown: scene.chosen }
      : { kind: "noGlove", chosen: scene.chosen };
  }
  const orchestratorLost = lost("task-orchestrator");
  if (glove.task !== null) return promptOf(scene, glove, glove.task, orchestratorLost !== null);
  if (orchestratorLost !== null) return orchestratorLost;
  const process = processOf(scene, glove);
  if (process === null) return endedOf(scene, glove);
  const turn = othersTurn(scene, glove, process);
  if (turn !== null && turn.kind !== "between") return turn; // nobody reaches into the cell while a robot moves
  const incident = incidentOf(process, glove);
  if (incident !== null) return { kind: "incident", glove, process, incident };
  return turn ?? { kind: "between", glove, process, task: null, next: nextOf(process) };
}

/** Return the scene as a station shows it: its own gloves, worn by the person who has joined; the only one is chosen. */
export function atStation(scene: Scene, { gloves, joined }: Pick<StationView, "gloves" | "joined">): Scene {
  const person = joined?.person ?? null;
  const own = scene.gloves.filter(({ glove }) => gloves.includes(glove)).map((glove) => (person === null ? glove : { ...glove, person }));
  const only = gloves.length === 1 ? (gloves[0] ?? null) : null;
  return { ...scene, gloves: own, chosen: scene.chosen ?? only };
}

/** Return the glove of this page: the one in the URL, else the only one. */
export function gloveOf({ gloves, chosen }: Pick<Scene, "gloves" | "chosen">): GloveView | null {
  if (chosen !== null) return gloves.find((glove) => glove.glove === chosen || glove.person === chosen) ?? null;
  return gloves.length === 1 ? (gloves[0] ?? null) : null;
}

/** Return the definitions without required parameters that are not suspended, the last used first. */
export function startable(scene: Pick<Scene, "definitions" | "processes">): DefinitionView[] {
  const last = latest(scene.processes)?.definition;
  return scene.definitions
    .filter((definition) => definition.unusable === undefined && !definition.holds.some(({ kind }) => kind === "suspended") && !definition.parameters.some(({ required }) => required))
    .sort((a, b) => Number(b.name === last) - Number(a.name === last) || (a.title < b.title ? -1 : 1));
}

/**
* Return the parameters with which this page starts a process: if the definition has exactly one glove,
* it is the glove of the page.
 */
export function parametersFor(definition: DefinitionView, glove: string): Record<string, string> {
  const gloves = definition.parameters.filter(
    (parameter) => typeof parameter.default === "string" && /^Device:glove\b/.test(parameter.default),
  );
  const [only] = gloves;
  const own = `Device:${glove}`;
  return gloves.length === 1 && only !== undefined && only.default !== own ? { [only.name]: own } : {};
}

/** Return the process that was started last. */
export function latest(processes: readonly ProcessView[]): ProcessView | null {
  return processes.reduce<ProcessView | null>(
    (last, process) => (last === null || process.startedAt > last.startedAt ? process : last),
    null,
  );
}

function promptOf(scene: Scene, glove: GloveView, task: GloveTask, answerWaits: boolean): Situation {
  const process = scene.processes.find((process) => process.tasks.some(({ id }) => isSame(task.id, id))) ?? null;
  const prompt: Prompt = { glove, task, process, next: nextOf(process) };
  if (glove.lost) return { kind: "gloveLost", ...prompt };
  if (glove.paused) return { kind: "paused", ...prompt };
  return { kind: "prompt", answerWaits, ...prompt };
}

/** The work of others in the process: of a robot, else of another person. */
function othersTurn(scene: Scene, glove: GloveView, process: ProcessView): Situation | null {
  const open = process.tasks.filter(({ endedAt }) => endedAt === null);
  const robotOf = (task: TaskView) =>
    scene.robots.find((robot) => task.involves.some((resource) => isSame(resource, robot.device))) ?? null;
  const atRobot = open.find((task) => robotOf(task) !== null) ?? open.find(({ workParameters }) => "operation" in workParameters);
  if (atRobot !== undefined) {
    const away = lostService(scene.services, "trajectory-tool");
    if (away !== null) return away;
    return { kind: "robot", glove, process, task: atRobot, robot: robotOf(atRobot), next: nextOf(process) };
  }
  // A Task of this glove, which the controller shows soon, is not another person's.
  const task = open.find(({ involves }) => !involves.some((resource) => namesOf(glove).some((name) => isSame(resource, name)))) ?? null;
  return task === null ? null : { kind: "between", glove, process, task, next: nextOf(process) };
}

/**
* Return the running process in which this glove is involved, else any. A process with a working robot comes
 * first if the latest has an incident.
 */
function processOf(scene: Scene, glove: GloveView): ProcessView | null {
  const running = scene.processes.filter(({ endedAt }) => endedAt === null);
  const mine = running.filter((process) => involves(process, glove));
  const own = mine.length > 0 ? mine : running;
  const last = latest(own);
  if (last === null || last.incidents.length === 0) return last;
  return latest(own.filter((process) => othersTurn(scene, glove, process)?.kind === "robot")) ?? last;
}

/** Return the name of the step at which an incident is. */
export function stepOf({ name, element }: Pick<IncidentView, "name" | "element">): string {
  return name === "" ? element : name;
}

/** Return the incident to show: one at a Task of this glove, else the first. */
export function incidentOf(process: ProcessView, glove: GloveView): IncidentView | null {
  const isMine = ({ task }: IncidentView) =>
    process.tasks.some(({ id, involves: who }) => isSame(id, task) && who.some((resource) => namesOf(glove).some((name) => isSame(resource, name))));
  return process.incidents.find(isMine) ?? process.incidents[0] ?? null;
}

function involves(process: ProcessView, glove: GloveView): boolean {
  const resources = [
    ...process.tasks.flatMap((task) => task.involves),
    ...process.next.flatMap((activity) => activity.involves),
    ...Object.values(process.parameters).filter((value) => typeof value === "string"),
  ];
  return resources.some((resource) => namesOf(glove).some((name) => isSame(resource, name)));
}

function namesOf({ glove, person }: GloveView): string[] {
  return person === null ? [glove] : [glove, person];
}

function endedOf(scene: Scene, glove: GloveView): Situation {
  const offer: Offer = { startable: startable(scene), glove };
  const last = latest(scene.processes.filter((process) => involves(process, glove))) ?? latest(scene.processes);
  if (last?.status === "failed" && !wasCancelled(last)) return { kind: "failed", process: last, ...offer };
  if (last?.status === "completed") return { kind: "completed", process: last, ...offer };
  return { kind: "idle", ...offer };
}

function wasCancelled(process: ProcessView): boolean {
  return /^cancelled\b/.test(process.reason ?? "");
}

function nextOf(process: ProcessView | null): NextActivity | null {
  return process?.next[0] ?? null;
}

function lostService(services: readonly ServiceHealth[], service: NeededService): Situation | null {
  const health = services.find(({ name }) => name === service);
  return health?.state === "down" ? { kind: "serviceLost", service, detail: health.detail } : null;
}
