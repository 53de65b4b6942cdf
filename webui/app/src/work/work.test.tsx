import { act, render, screen, waitFor, within } from "@testing-library/react";
import userEvent from "@testing-library/user-event";
import i18next from "i18next";
import { afterEach, beforeAll, beforeEach, describe, expect, it, vi } from "vitest";
import { setLanguage, initI18n } from "~/i18n";
import { Live } from "~/live/hooks";
import type { GloveView } from "~/live/messages";
import { LiveStore } from "~/live/store";
import { setKiosk } from "~/shell/kiosk";
import { setUserName } from "~/shell/userName";
import { incident } from "~/testing/views";
import { REST_AFTER_MS } from "./awake";
import { startRequest } from "./confirmation";
import { completed, definition, failed, glove, process, robot, robotTask, service, stopped, task, userTask } from "./scene.fixture";
import WorkPage from "./WorkPage";

const hold = { announceMs: 500, confirmMs: 1500, spent: false };

function topics(...parts: [string, unknown][]): Record<string, unknown> {
  return { "robot/ur10-1": robot, "definition/bin-picking": definition(), services: [], ...Object.fromEntries(parts) };
}

function publish(live: LiveStore, values: Record<string, unknown>, type: "snapshot" | "batch" = "batch"): void {
  live.apply({ type, at: "", topics: values, events: [] });
  live.setLink("open");
}

async function open(...parts: [string, unknown][]): Promise<LiveStore> {
  const live = new LiveStore();
  publish(live, topics(...parts), "snapshot");
  await act(async () => {
    render(
      <Live value={live}>
        <WorkPage />
      </Live>,
    );
    await Promise.resolve();
  });
  return live;
}

const asks = (part: Partial<GloveView> = {}): [string, unknown] => [
  "glove/glove-1",
  glove({ task, message: { key: "show", values: { gesture: "Thumbs up" }, text: "Show: Thumbs up." }, ...part }),
];

beforeAll(async () => {
  await initI18n();
  await i18next.loadNamespaces(["work", "hand", "system"]);
  await setLanguage("en");
});

beforeEach(() => history.replaceState(null, "", "/work"));
afterEach(() => vi.unstubAllGlobals());

describe("the operator's page", () => {
  it("says what to do, the gesture, and what comes next", async () => {
    const next = [{ element: "scan", name: "Scan the bin", description: null, lane: "Robot", involves: [] }];
    await open(asks(), ["process/1", process({ tasks: [userTask], next })]);
    expect(screen.getByRole("heading", { name: task.description })).toBeTruthy();
    expect(screen.getByRole("img", { name: /^Thumbs up: thumb straight, index finger bent/ })).toBeTruthy();
    expect(screen.getByText("Next (Robot): Scan the bin")).toBeTruthy();
    expect(screen.getByText("Emergency stop: the red button on the cell, never a gesture.")).toBeTruthy();
    expect(screen.getByRole("button", { name: "Complete by hand" })).toBeTruthy();
  });

  it("says the next two steps, and who does each", async () => {
    const next = [{ element: "scan", name: "Scan the bin", description: null, lane: "Robot", involves: [] }];
    const afterNext = [{ element: "grip", name: "Confirm the grip", description: null, lane: "Operator", involves: [] }];
    await open(asks(), ["process/1", process({ tasks: [userTask], next, afterNext })]);
    expect(screen.getByText("Next (Robot): Scan the bin")).toBeTruthy();
    expect(screen.getByText("Then (Operator): Confirm the grip")).toBeTruthy();
  });

  it("shows a finished step again, and closes it when another question comes", async () => {
    const over = { ...userTask, id: "urn:ngsi-ld:Task:demo:bin-picking-1-clear-1", description: "Clear the bin", status: "completed", endedAt: "2026-01-01T10:00:30Z", outputParameters: { by: "gesture" } } as const;
    const live = await open(asks(), ["process/1", process({ tasks: [over, userTask] })]);
    await userEvent.click(screen.getByRole("button", { name: "Finished steps" }));
    const dialog = screen.getByRole("dialog");
    expect(within(dialog).getByText("Clear the bin")).toBeTruthy();
    expect(within(dialog).getByText("Confirmed with Thumbs up")).toBeTruthy();
    expect(within(dialog).getByText(`Running: ${task.description}`)).toBeTruthy();
    const following = { ...task, id: `${task.id}-2`, description: "And now the next thing" };
    act(() => publish(live, Object.fromEntries([asks({ task: following })])));
    await waitFor(() => expect(screen.queryByRole("dialog")).toBeNull());
  });

  it("dims an idle kiosk, wakes it when the hand moves, and leaves other screens alone", async () => {
    vi.useFakeTimers();
    try {
      const live = await open(["glove/glove-1", glove()]);
      await act(() => vi.advanceTimersByTimeAsync(2 * REST_AFTER_MS));
      expect(screen.queryByText("Move the glove or touch the screen.")).toBeNull();
      act(() => setKiosk(true));
      await act(() => vi.advanceTimersByTimeAsync(REST_AFTER_MS + 1));
      expect(screen.getByText("Move the glove or touch the screen.")).toBeTruthy();
      act(() => publish(live, { "glove/glove-1": glove({ states: "02222" }) }));
      expect(screen.queryByText("Move the glove or touch the screen.")).toBeNull();
      await act(() => vi.advanceTimersByTimeAsync(REST_AFTER_MS + 1));
      expect(screen.getByText("Move the glove or touch the screen.")).toBeTruthy();
      act(() => publish(live, Object.fromEntries([asks()])));
      expect(screen.queryByText("Move the glove or touch the screen.")).toBeNull();
    } finally {
      act(() => setKiosk(false));
      vi.useRealTimers();
    }
  });

  it("keeps the screen on while somebody is asked, and no longer", async () => {
    const release = vi.fn(() => Promise.resolve());
    const request = vi.fn(() => Promise.resolve({ release }));
    Object.defineProperty(navigator, "wakeLock", { value: { request }, configurable: true });
    try {
      const live = await open(["glove/glove-1", glove()]);
      expect(request).not.toHaveBeenCalled();
      await act(async () => {
        publish(live, Object.fromEntries([asks()]));
        await Promise.resolve();
      });
      expect(request).toHaveBeenCalledWith("screen");
      act(() => publish(live, { "glove/glove-1": glove() }));
      await waitFor(() => expect(release).toHaveBeenCalled());
    } finally {
      Reflect.deleteProperty(navigator, "wakeLock");
    }
  });

  it("names the finger that differs, in the language of the page", async () => {
    const values = { shown: "Thumb and little straight", stretch: [], bend: ["little"] };
    const message = { key: "wrong", values, text: "Thumb and little straight is not it: bend your little finger." };
    await open(asks({ states: "02220", differs: ["little"], message }));
    expect(screen.getByText("That is Thumb and little straight: bend your little finger.")).toBeTruthy();
    await act(() => setLanguage("de"));
    expect(await screen.findByText("Das ist „Daumen und kleiner Finger gestreckt“: kleinen Finger beugen.")).toBeTruthy();
    await act(() => setLanguage("fi"));
    expect(await screen.findByText("Tämä on ”Peukalo ja pikkusormi suorana”: koukista pikkusormi.")).toBeTruthy();
    await act(() => setLanguage("en"));
  });

  it("shows both hands of a gesture that takes both, and says which is right", async () => {
    const parts = [
      { gesture: "Thumbs up", code: "02222", hand: "left", state: "now" },
      { gesture: "Horns", code: "20220", hand: "right", state: "held" },
    ] as const;
    const both = { ...task, gesture: "Both", code: "20220", parts: [...parts] };
    const right = asks({ task: both, person: "anna", states: "20220" });
    await open(right, ["glove/left-1", glove({ glove: "left-1", hand: "left", person: "anna" })]);
    await act(async () => {
      screen.getByRole("button", { name: /glove-1/ }).click();
      await Promise.resolve();
    });
    const [left, other] = screen.getAllByRole("listitem");
    expect(left?.textContent).toBe("Left handThumbs upshow it now");
    expect(other?.textContent).toBe("Right handHornsright");
    expect(screen.getAllByRole("img", { name: /Your hand now/ })[1]).toBeTruthy();
    expect(screen.getAllByRole("img")).toHaveLength(4);
  });

  it("shows two gestures in turn, and which of them is due", async () => {
    const parts = [
      { gesture: "Point with index", code: "20222", hand: null, state: "done" },
      { gesture: "Horns", code: "20220", hand: null, state: "now" },
    ] as const;
    await open(asks({ task: { ...task, gesture: "Wave off", code: "20220", parts: [...parts] } }));
    expect(screen.getAllByRole("listitem").map(({ textContent }) => textContent)).toEqual([
      "FirstPoint with indexdone",
      "ThenHornsshow it now",
    ]);
    expect(screen.getByRole("img", { name: /Your hand now/ })).toBeTruthy();
  });

  it("leaves in English what a newer controller says and this page does not know", async () => {
    await open(asks({ message: { key: "newer", values: {}, text: "Something new." } }));
    expect(screen.getByText("Something new.")).toBeTruthy();
  });

  it("answers a hold that counted with a check, even when the next Task is there at once", async () => {
    const live = await open(asks(), ["process/1", process({ tasks: [userTask] })]);
    const answered = { task: task.id, gesture: "Thumbs up", by: "gesture", operator: null } as const;
    const following = { ...task, id: `${task.id}-2`, description: "And now the next thing" };
    act(() => publish(live, Object.fromEntries([asks({ task: following, answered })])));
    expect(screen.getByText("Confirmed")).toBeTruthy();
    expect(await screen.findByText("And now the next thing", {}, { timeout: 3000 })).toBeTruthy();
  });

  it("shows no check for an answer that this screen has not asked for", async () => {
    const answered = { task: "urn:ngsi-ld:Task:demo:earlier", gesture: "Horns", by: "gesture", operator: null } as const;
    const live = await open(asks());
    act(() => publish(live, Object.fromEntries([asks({ answered })])));
    expect(screen.queryByText("Confirmed")).toBeNull();
  });

  it("says what the robot does, how long it takes, and to keep out", async () => {
    const busy = { ...robot, task: robotTask.id, operation: "scan", progress: 0.4, remainingS: 2.3 };
    await open(["glove/glove-1", glove()], ["process/1", process({ tasks: [robotTask] })], ["robot/ur10-1", busy]);
    expect(screen.getByRole("heading", { name: "The robot scans the bin" })).toBeTruthy();
    expect(screen.getByText("about 3 s left")).toBeTruthy();
    expect(screen.getByRole("progressbar").getAttribute("aria-valuenow")).toBe("40");
    expect(screen.getByText("Keep out of the cell")).toBeTruthy();
  });

  it("asks the person to hold the part of a hand-over, and confirms that very Task", async () => {
    const sent: unknown[] = [];
    vi.stubGlobal("fetch", (url: string, { body }: { body: string }) => {
      sent.push([url, JSON.parse(body)]);
      return Promise.resolve(new Response("{}", { headers: { "content-type": "application/json" } }));
    });
    const waits = { ...robot, task: robotTask.id, operation: "handOver", awaitsConfirmation: true, gripper: { ...robot.gripper, closed: true, holds: "gear-3" } };
    await open(["glove/glove-1", glove()], ["process/1", process({ tasks: [robotTask] })], ["robot/ur10-1", waits]);
    expect(screen.getByText("Hold gear-3 firmly, then confirm: the gripper opens.")).toBeTruthy();
    expect(screen.queryByText("Keep out of the cell")).toBeNull();
    const button = screen.getByRole("button", { name: "I hold the part" });
    expect(button.className).toContain("button--large");
    await userEvent.click(button);
    expect(sent).toEqual([["/api/trajectory-tool/robots/ur10-1/confirm", { task: robotTask.id }]]);
    expect(screen.getByRole("button", { name: "I hold the part" })).toHaveProperty("disabled", true);
  });

  it("says that the glove is lost and still lets the step be completed by hand", async () => {
    await open(asks({ connected: false, lost: true }));
    expect(screen.getByRole("alert").textContent).toContain("Connection to glove-1 lost");
    expect(screen.getByRole("button", { name: "Complete by hand" })).toBeTruthy();
  });

  it("says that the broker is gone, in its place on the whole page", async () => {
    await open(asks(), ["services", [service("context-broker", "down")]]);
    expect(screen.getByRole("alert").textContent).toContain("Context broker not responding");
    expect(screen.queryByRole("button", { name: "Complete by hand" })).toBeNull();
  });

  it("waits a moment before it calls the link lost", async () => {
    const live = await open(asks());
    act(() => live.setLink("lost"));
    expect(screen.getByRole("heading", { name: task.description })).toBeTruthy();
    expect(await screen.findByText("No connection to the cell", {}, { timeout: 3000 })).toBeTruthy();
    act(() => live.setLink("open"));
    expect(screen.getByRole("heading", { name: task.description })).toBeTruthy();
  });

  it("starts a process once when the hand is held to the end, with a request that all screens share", async () => {
    const sent: unknown[] = [];
    vi.stubGlobal("fetch", (url: string, { body }: { body: string }) => {
      sent.push([url, JSON.parse(body)]);
      return Promise.resolve(Response.json({}, { status: 201 }));
    });
    const live = await open(["glove/glove-1", glove()], ["process/1", completed]);
    const up = (heldMs: number) => ({ "glove/glove-1": glove({ states: "02222", hold: { ...hold, gesture: "Thumbs up", heldMs } }) });
    for (const heldMs of [30, 700, 1490]) act(() => publish(live, up(heldMs)));
    expect(sent).toEqual([]);
    for (const heldMs of [1510, 1700, 2500]) {
      await act(async () => {
        publish(live, up(heldMs));
        await Promise.resolve();
      });
    }
    expect(sent).toEqual([
      ["/api/task-orchestrator/processes", { definition: "bin-picking", parameters: {}, request: startRequest("glove-1", "bin-picking", "bin-picking-1") }],
    ]);
  });

  it("answers that something is not good, with a note, after one question that names it", async () => {
    const sent: unknown[] = [];
    vi.stubGlobal("fetch", (url: string, { body }: { body: string }) => {
      sent.push([url, JSON.parse(body)]);
      return Promise.resolve(Response.json({}));
    });
    setUserName("Anna");
    await open(asks());
    await userEvent.click(screen.getByRole("button", { name: "Not good" }));
    expect(sent).toEqual([]);
    await userEvent.type(screen.getByRole("textbox", { name: "Note (optional)" }), "scratched");
    await userEvent.click(screen.getByRole("button", { name: "Report “Not good”" }));
    expect(sent).toEqual([
      ["/api/gesture-controller/gloves/glove-1/complete", { by: "Anna", task: task.id, outcome: "notGood", note: "scratched" }],
    ]);
    await waitFor(() => expect(screen.queryByRole("dialog")).toBeNull());
  });

  it("shows the gestures that answer otherwise, and only those that are configured", async () => {
    const answers = [
      { outcome: "notGood", gesture: "Horns", code: "20220" },
      { outcome: "problem", gesture: null, code: null },
    ] as const;
    await open(asks({ task: { ...task, answers: [...answers] } }));
    expect(screen.getByRole("img", { name: /^Horns:/ }).parentElement?.textContent).toBe("Not good");
    expect(screen.getAllByText("Problem")).toHaveLength(1);
  });

  it("says what has been reported, by whom and with which note, where a process has failed by it", async () => {
    const reported = {
      ...userTask,
      status: "failed",
      endedAt: "2026-01-01T10:01:00Z",
      reason: "notGood: scratched",
      outputParameters: { outcome: "notGood", note: "scratched", operator: "Anna", by: "screen" },
    } as const;
    await open(["glove/glove-1", glove()], ["process/1", { ...failed, reason: "notGood: scratched", retry: null, tasks: [reported] }]);
    expect(screen.getByRole("alert").textContent).toContain("Confirm: Not good, reported by Anna. “scratched”");
  });

  it("shows the step with an incident and why, and retries it under a name", async () => {
    const sent: unknown[] = [];
    vi.stubGlobal("fetch", (url: string, { body }: { body: string }) => {
      sent.push([url, JSON.parse(body)]);
      return Promise.resolve(Response.json({}));
    });
    setUserName("Anna");
    const other = incident({ token: "9", element: "place", name: "Place the part", task: null });
    await open(["glove/glove-1", glove()], ["process/1", { ...stopped, incidents: [...stopped.incidents, other] }]);
    const state = screen.getByRole("alert").textContent;
    expect(state).toContain("Bin picking: a step has failed");
    expect(state).toContain("Scan the bin: the robot could not pick");
    expect(state).toContain("1 more step has failed.");
    await userEvent.click(screen.getByRole("button", { name: "Retry the step" }));
    expect(sent).toEqual([["/api/task-orchestrator/processes/bin-picking-1/tokens/7/retry", { by: "Anna" }]]);
  });

  it("asks once before it cancels a process with an incident", async () => {
    const sent: unknown[] = [];
    vi.stubGlobal("fetch", (url: string, { body }: { body: string }) => {
      sent.push([url, JSON.parse(body)]);
      return Promise.resolve(Response.json({}));
    });
    setUserName("Anna");
    await open(["glove/glove-1", glove()], ["process/1", stopped]);
    await userEvent.click(screen.getByRole("button", { name: "Cancel Bin picking" }));
    expect(sent).toEqual([]);
    await userEvent.click(within(screen.getByRole("dialog")).getByRole("button", { name: "Cancel Bin picking" }));
    expect(sent).toEqual([["/api/task-orchestrator/processes/bin-picking-1/cancel", { by: "Anna" }]]);
  });

  it("offers the way out of test mode, where nothing else can be done", async () => {
    const sent: unknown[] = [];
    vi.stubGlobal("fetch", (url: string, { body }: { body: string }) => {
      sent.push([url, JSON.parse(body)]);
      return Promise.resolve(Response.json({}));
    });
    await open(asks({ testing: true }));
    expect(screen.queryByRole("button", { name: "Complete by hand" })).toBeNull();
    await userEvent.click(screen.getByRole("button", { name: "Leave test mode" }));
    expect(sent).toEqual([["/api/gesture-controller/gloves/glove-1/modes", { testing: false }]]);
  });

  it("says that it is paused on the whole page, and how to resume", async () => {
    await open(asks({ paused: true, message: { key: "pausedOnScreen", values: {}, text: "Paused." } }));
    expect(screen.getByRole("heading", { name: "Paused" }).closest(".full-page-state--attention")).toBeTruthy();
    expect(screen.getByText(`Waiting: ${task.description}`)).toBeTruthy();
    expect(screen.getAllByRole("button", { name: "Resume" }).length).toBeGreaterThan(0);
  });

  it("stays with its glove when another one joins", async () => {
    const live = await open(asks());
    expect(location.search).toBe("?glove=glove-1");
    act(() => publish(live, { "glove/glove-2": glove({ glove: "glove-2" }) }));
    expect(screen.getByRole("heading", { name: task.description })).toBeTruthy();
  });
});
