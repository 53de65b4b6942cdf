import { describe, expect, it } from "vitest";
import * as views from "~/testing/views";
import { completed, definition, failed, glove, process, robotTask, scene, service, stopped, task, userTask } from "./scene.fixture";
import { latest, parametersFor, situationOf, startable, type Scene, type Situation } from "./situation";

const table: [string, Partial<Scene>, Situation["kind"]][] = [
  ["before anything was received", { hasSnapshot: false, link: "connecting" }, "connecting"],
  ["when nothing could ever be received", { hasSnapshot: false, link: "lost" }, "linkLost"],
  ["when the link breaks, whatever was asked", { link: "lost", gloves: [glove({ task })] }, "linkLost"],
  ["without the broker", { services: [service("context-broker", "down")], gloves: [glove({ task })] }, "serviceLost"],
  ["without the controller", { services: [service("gesture-controller", "down")] }, "serviceLost"],
  ["without the orchestrator", { services: [service("task-orchestrator", "down")] }, "serviceLost"],
  ["with a service that is only impaired", { services: [service("context-broker", "degraded")] }, "idle"],
  ["without the orchestrator, but asked already", { services: [service("task-orchestrator", "down")], gloves: [glove({ task })] }, "prompt"],
  ["without any glove", { gloves: [] }, "noGlove"],
  ["with another glove than the chosen one", { chosen: "glove-9" }, "noGlove"],
  ["with several gloves and none chosen", { gloves: [glove(), glove({ glove: "glove-2" })] }, "chooseGlove"],
  ["with several gloves and one chosen", { gloves: [glove(), glove({ glove: "glove-2" })], chosen: "glove-2" }, "idle"],
  ["with a person chosen", { gloves: [glove({ person: "anna" }), glove({ glove: "glove-2" })], chosen: "anna" }, "idle"],
  ["with a Task", { gloves: [glove({ task })], processes: [process({ tasks: [userTask] })] }, "prompt"],
  ["with a Task and no glove on", { gloves: [glove({ task, connected: false })] }, "prompt"],
  ["when the glove goes silent in a Task", { gloves: [glove({ task, connected: false, lost: true })] }, "gloveLost"],
  ["when the work is paused", { gloves: [glove({ task, paused: true })] }, "paused"],
  ["when the robot works", { processes: [process({ tasks: [robotTask] })] }, "robot"],
  ["when a robot without a view works", { processes: [process({ tasks: [robotTask] })], robots: [] }, "robot"],
  ["when the robot should work and its tool is away", { processes: [process({ tasks: [robotTask] })], services: [service("trajectory-tool", "down")] }, "serviceLost"],
  ["when the tool is away and nobody needs it", { services: [service("trajectory-tool", "down")] }, "idle"],
  ["between two Tasks", { processes: [process({ tasks: [{ ...robotTask, endedAt: "2026-01-01T10:00:09Z" }] })] }, "between"],
  ["when another person is asked", { processes: [process({ tasks: [{ ...userTask, involves: ["urn:ngsi-ld:Person:demo:ben"] }] })] }, "between"],
  ["when the process has failed", { processes: [failed] }, "failed"],
  ["when the process was cancelled", { processes: [{ ...failed, reason: "cancelled by Anna", retry: null }] }, "idle"],
  ["when the process is done", { processes: [completed] }, "completed"],
  ["when a step has stopped with an incident", { processes: [stopped] }, "incident"],
  ["when another branch asks this glove beside an incident", { gloves: [glove({ task })], processes: [{ ...stopped, tasks: [userTask] }] }, "prompt"],
  ["when a robot moves beside an incident", { processes: [{ ...stopped, tasks: [robotTask] }] }, "robot"],
  ["when another person is asked beside an incident", { processes: [{ ...stopped, tasks: [{ ...userTask, involves: ["urn:ngsi-ld:Person:demo:ben"] }] }] }, "incident"],
  ["when an older process moves the robot beside an incident", { processes: [process({ id: "p-1", tasks: [robotTask] }), { ...stopped, startedAt: "2026-01-02T10:00:00Z" }] }, "robot"],
  ["when one has failed and the next one runs", { processes: [failed, process({ tasks: [robotTask] })] }, "robot"],
  ["with nothing to do", {}, "idle"],
];

describe("the situation", () => {
  it.each(table)("%s", (_, part, kind) => {
    expect(situationOf(scene(part)).kind).toBe(kind);
  });

  it("has the process that asks, not another one that runs", () => {
    const mine = process({ id: "p-1", tasks: [userTask] });
    const other = process({ id: "p-2", startedAt: "2026-01-02T10:00:00Z", tasks: [robotTask] });
    const situation = situationOf(scene({ gloves: [glove({ task })], processes: [mine, other] }));
    expect(situation.kind === "prompt" && situation.process?.id).toBe("p-1");
  });

  it("follows the process that this glove has a part in", () => {
    const mine = process({ id: "p-1", tasks: [robotTask], parameters: { operator: "Device:glove-1" } });
    const other = process({ id: "p-2", startedAt: "2026-01-02T10:00:00Z", tasks: [robotTask], parameters: {} });
    const situation = situationOf(scene({ processes: [mine, other] }));
    expect(situation.kind === "robot" && situation.process.id).toBe("p-1");
  });

  it("has the incident at a step of this glove before others", () => {
    const other = views.incident({ token: "3", element: "scan", task: robotTask.id });
    const mine = views.incident({ token: "4", element: "confirm", task: userTask.id });
    const ended = "2026-01-01T10:00:09Z";
    const tasks = [{ ...robotTask, endedAt: ended }, { ...userTask, endedAt: ended }];
    const situation = situationOf(scene({ processes: [process({ tasks, incidents: [other, mine] })] }));
    expect(situation.kind === "incident" && situation.incident.token).toBe("4");
    const without = situationOf(scene({ processes: [process({ incidents: [other] })] }));
    expect(without.kind === "incident" && without.incident.token).toBe("3");
  });

  it("is no other person's turn while the Task of this glove is on its way", () => {
    const situation = situationOf(scene({ processes: [process({ tasks: [userTask] })] }));
    expect(situation.kind === "between" && situation.task).toBeNull();
  });

  it("says that an answer waits while the orchestrator is away", () => {
    const situation = situationOf(scene({ services: [service("task-orchestrator", "down")], gloves: [glove({ task })] }));
    expect(situation.kind === "prompt" && situation.answerWaits).toBe(true);
  });
});

describe("what can be started", () => {
  it("needs nothing that the page cannot say, and begins with what ran last", () => {
    const definitions = [
      definition({ name: "a", title: "A" }),
      definition({ name: "b", title: "B" }),
      definition({ name: "c", title: "C", unusable: "it names an unknown lane" }),
      definition({ name: "d", title: "D", parameters: [{ name: "part", required: true, default: null }] }),
      definition({ name: "e", title: "E", holds: [{ kind: "suspended", by: "Olga", why: null, at: "2026-05-04T08:00:00.000Z", verified: false }] }),
    ];
    expect(startable({ definitions, processes: [] }).map(({ name }) => name)).toEqual(["a", "b"]);
    const processes = [process({ definition: "b" })];
    expect(startable({ definitions, processes }).map(({ name }) => name)).toEqual(["b", "a"]);
  });

  it("works with the glove of the page, where the process has exactly one", () => {
    const single = definition({ parameters: [{ name: "operator", required: false, default: "Device:glove-1" }] });
    expect(parametersFor(single, "glove-1")).toEqual({});
    expect(parametersFor(single, "glove-2")).toEqual({ operator: "Device:glove-2" });
    const two = definition({ parameters: [...single.parameters, { name: "helper", required: false, default: "Device:glove-2" }] });
    expect(parametersFor(two, "glove-3")).toEqual({});
  });

  it("knows which process was started last", () => {
    expect(latest([])).toBeNull();
    expect(latest([process({ id: "new", startedAt: "2026-01-02T00:00:00Z" }), process({ id: "old" })])?.id).toBe("new");
  });
});
