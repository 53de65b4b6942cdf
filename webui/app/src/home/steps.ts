/**
 * The steps from an empty cell to the first process, in their order. The guide offers the first that is not done.
 *
 * A new step is a row here; its texts are `home:step.<name>` and `home:act.<name>`. What is done is read from the cell, so
 * a step that was taken elsewhere, on the command line or by a colleague, is done as well.
 */
import { Bot, Hand, UserPlus, Workflow } from "lucide-react";
import type { ComponentType } from "react";
import { startOperator, startProcess } from "~/api/actions";
import type { DefinitionView } from "~/api/generated/task-orchestrator";
import { addresses } from "~/places/addresses";
import { pathOf } from "~/processes/address";
import { mayDo, type Permission } from "~/session/session";

const FIRST_GLOVE = "glove-1";
/** The process that is offered first, and the robot for which it is written. */
const EXAMPLE = { definition: "bin-picking", robot: "ur10-1" } as const;

/** What the steps look at. */
export interface Facts {
  services: readonly string[];
  /** Those of `services` that answer. */
  up: readonly string[];
  gloves: readonly { glove: string; connected: boolean }[];
  robots: readonly string[];
  definitions: readonly Pick<DefinitionView, "name" | "title" | "unusable" | "parameters">[];
  /** Whether a process was ever started. */
  hasProcess: boolean;
  /** The simulated hand: whether it runs, and what it last said. */
  operator: { running: boolean; detail: string | null } | null;
  hasAccounts: boolean;
  /** How many people have an account or an open invitation; null while unknown. */
  people: number | null;
}

export interface StepAct {
  /** The text is `home:act.<name>`, with `values`. */
  name: string;
  values?: Readonly<Record<string, string>>;
  permission: Permission;
  /** The address that it opens. */
  to?: string;
  /** What it does; it returns the address to open then, or null to stay. */
  run?: () => Promise<string | null>;
  /** The guide is put away. */
  ends?: true;
}

export interface Step {
  name: string;
  icon: ComponentType<{ size?: number; "aria-hidden"?: boolean }>;
  /** Who takes the step; to others it is not shown. */
  permission: Permission;
  isOffered: (facts: Facts) => boolean;
  isDone: (facts: Facts) => boolean;
  /** It has been begun and takes a moment. */
  isPending?: (facts: Facts) => boolean;
  /** The text that explains it, `home:step.<name>.<what>`; "what" without it. */
  whatOf?: (facts: Facts) => string;
  /** The first act is the one that is proposed. */
  acts: (facts: Facts) => readonly StepAct[];
  /** A command for a terminal, where the page cannot do it; its text is `home:step.<name>.terminal`. */
  commandOf?: (facts: Facts) => string | null;
  /** What a service says that hinders the step. */
  faultOf?: (facts: Facts) => string | null;
  /** Where to look at what was done. */
  see?: (facts: Facts) => string | null;
}

const has = (service: string) => (facts: Facts) => facts.services.includes(service);

export const STEPS: readonly Step[] = [
  {
    name: "glove",
    icon: Hand,
    permission: "configure",
    isOffered: has("gesture-controller"),
    isDone: ({ gloves }) => gloves.some(({ connected }) => connected),
    isPending: ({ operator }) => operator?.running === true,
    acts: ({ gloves }) => [
      { name: "simulateHand", permission: "configure", run: () => startOperator(gloves[0]?.glove ?? FIRST_GLOVE).then(() => null) },
      ...(gloves.length === 0 ? [] : [{ name: "seeGloves", permission: "read" as const, to: addresses.gloves() }]),
    ],
    commandOf: () => "handover glove serial /dev/ttyUSB0",
    faultOf: ({ operator }) => operator?.detail ?? null,
    see: ({ gloves }) => {
      const glove = gloves.find(({ connected }) => connected);
      return glove === undefined ? null : addresses.glove(glove.glove);
    },
  },
  {
    name: "robot",
    icon: Bot,
    permission: "configure",
    isOffered: (facts) => ["trajectory-tool", "device-gateway", "ros-bridge"].some((service) => has(service)(facts)),
    isDone: ({ robots }) => robots.length > 0,
    acts: ({ up }) => (up.includes("device-gateway") ? [{ name: "addRobot", permission: "configure", to: addresses.devices({ add: "yes" }) }] : []),
    commandOf: ({ up }) => (up.includes("trajectory-tool") ? "handover robot add ROBOT.urdf" : "handover run trajectory-tool"),
    see: ({ robots: [robot] }) => (robot === undefined ? null : addresses.robot(robot)),
  },
  {
    name: "process",
    icon: Workflow,
    permission: "runProcesses",
    isOffered: has("task-orchestrator"),
    isDone: ({ hasProcess }) => hasProcess,
    whatOf: (facts) => (exampleOf(facts) === null ? "none" : exampleOf(facts)?.name === EXAMPLE.definition ? "example" : "what"),
    acts: (facts) => {
      const example = exampleOf(facts);
      return [
        ...(example === null ? [] : [{ name: "startExample", values: { title: example.title }, permission: "runProcesses" as const, run: () => startExample(example.name, facts) }]),
        { name: "upload", permission: "deployProcesses", to: pathOf({ kind: "upload" }) },
        ...(usable(facts).length > 1 ? [{ name: "chooseProcess", permission: "runProcesses" as const, to: addresses.processes() }] : []),
      ];
    },
    see: () => addresses.processes(),
  },
  {
    name: "people",
    icon: UserPlus,
    permission: "managePeople",
    isOffered: () => true,
    isDone: ({ hasAccounts, people }) => hasAccounts && (people ?? 0) > 1,
    whatOf: ({ hasAccounts }) => (hasAccounts ? "what" : "noAccounts"),
    acts: ({ hasAccounts }) => [
      ...(hasAccounts ? [{ name: "invite", permission: "managePeople" as const, to: addresses.people({ view: "invitations" }) }] : []),
      { name: "workAlone", permission: "read", ends: true },
    ],
    commandOf: ({ hasAccounts }) => (hasAccounts ? null : "handover secure"),
    see: () => addresses.people({ view: "users" }),
  },
];

/** The steps for this user in this cell. */
export function offeredSteps(facts: Facts, steps: readonly Step[] = STEPS): readonly Step[] {
  return steps.filter((step) => mayDo(step.permission) && step.isOffered(facts));
}

export function nextStep(facts: Facts, steps: readonly Step[] = STEPS): Step | null {
  return offeredSteps(facts, steps).find((step) => !step.isDone(facts)) ?? null;
}

function usable({ definitions }: Facts): Facts["definitions"] {
  return definitions.filter(({ unusable }) => unusable === undefined);
}

/** A process that starts without a question: the example, else the first without required parameters. */
export function exampleOf(facts: Facts): Facts["definitions"][number] | null {
  const ready = usable(facts).filter(({ parameters }) => parameters.every(({ required }) => !required));
  return ready.find(({ name }) => name === EXAMPLE.definition) ?? ready[0] ?? null;
}

async function startExample(definition: string, { robots }: Facts): Promise<string> {
  const [robot] = robots;
  const isOther = definition === EXAMPLE.definition && robot !== undefined && !robots.includes(EXAMPLE.robot);
  await startProcess(definition, isOther ? { robot: `Device:${robot}` } : {});
  return addresses.work();
}
