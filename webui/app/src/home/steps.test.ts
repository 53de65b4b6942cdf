import { expect, test } from "vitest";
import { exampleOf, nextStep, offeredSteps, STEPS, type Facts } from "./steps";

const EMPTY: Facts = {
  services: ["gesture-controller", "trajectory-tool", "task-orchestrator"],
  up: ["gesture-controller", "trajectory-tool", "task-orchestrator"],
  gloves: [],
  robots: [],
  definitions: [],
  hasProcess: false,
  operator: { running: false, detail: null },
  hasAccounts: false,
  people: null,
};
const definition = (name: string, required = false, more: { unusable?: string } = {}) => ({
  name,
  title: name,
  parameters: [{ name: "robot", type: "string", required, default: null }] as never,
  ...more,
});
/** What does each step, in their order. */
const DOES: readonly (readonly [string, Partial<Facts>])[] = [
  ["glove", { gloves: [{ glove: "glove-1", connected: true }] }],
  ["robot", { robots: ["ur10-1"] }],
  ["process", { hasProcess: true }],
  ["people", { hasAccounts: true, people: 2 }],
];

test("from an empty cell one step follows the other, until there is none", () => {
  let facts = EMPTY;
  for (const [name, done] of DOES) {
    expect(nextStep(facts)?.name).toBe(name);
    facts = { ...facts, ...done };
  }
  expect(nextStep(facts)).toBeNull();
  expect(offeredSteps(facts).map((step) => step.isDone(facts))).toEqual([true, true, true, true]);
});

test("steps may be done in any order: what is done is never offered", () => {
  for (const [name, done] of DOES) expect(nextStep({ ...EMPTY, ...done })?.name).not.toBe(name);
});

test("a step whose service is not installed is not offered", () => {
  expect(offeredSteps({ ...EMPTY, services: ["task-orchestrator"] }).map(({ name }) => name)).toEqual(["process", "people"]);
  expect(nextStep({ ...EMPTY, services: ["device-gateway"] })?.name).toBe("robot");
});

test("a glove that is not connected does not count, and the simulated hand takes its name", () => {
  const facts = { ...EMPTY, gloves: [{ glove: "left", connected: false }] };
  expect(nextStep(facts)?.name).toBe("glove");
  expect(nextStep(facts)?.acts(facts).map(({ name }) => name)).toEqual(["simulateHand", "seeGloves"]);
});

test("the example is bin picking, else what starts without a question; never what cannot start", () => {
  const facts = (...definitions: Facts["definitions"]) => ({ ...EMPTY, definitions });
  expect(exampleOf(facts(definition("a"), definition("bin-picking")))?.name).toBe("bin-picking");
  expect(exampleOf(facts(definition("asks", true), definition("b")))?.name).toBe("b");
  expect(exampleOf(facts(definition("asks", true), definition("broken", false, { unusable: "a form is missing" })))).toBeNull();
});

test("in each state each step that is not done has an act or a command, and each act does something", () => {
  for (const services of [EMPTY.services, ["device-gateway"], ["task-orchestrator", "whole-body-control"]]) {
    for (const hasAccounts of [false, true]) {
      for (const definitions of [[], [definition("bin-picking")], [definition("asks", true)]]) {
        const facts: Facts = { ...EMPTY, services, up: services, hasAccounts, definitions };
        for (const step of offeredSteps(facts, STEPS)) {
          const acts = step.acts(facts);
          expect(acts.length > 0 || step.commandOf?.(facts) != null, step.name).toBe(true);
          for (const act of acts) expect(act.to !== undefined || act.run !== undefined || act.ends === true, act.name).toBe(true);
        }
      }
    }
  }
});

test("without the service of robots, the step of the robot says how to start it", () => {
  const facts = { ...EMPTY, up: ["task-orchestrator"] };
  const step = offeredSteps(facts).find(({ name }) => name === "robot");
  expect(step?.commandOf?.(facts)).toBe("handover run trajectory-tool");
  expect(step?.commandOf?.(EMPTY)).toContain("handover robot add");
});
