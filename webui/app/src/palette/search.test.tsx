/** What is listed: acts only for those who may do them, what was used lately first, and rows that keep their place. */
import i18next from "i18next";
import { beforeEach, describe, expect, it, vi } from "vitest";
import { alertOf } from "~/alerts/alert.fixture";
import { initI18n } from "~/i18n";
import { ProcessTexts } from "~/live/processTexts";
import { LiveStore } from "~/live/store";
import { loadSession } from "~/session/session";
import { process, task } from "~/testing/views";
import { addActs } from "./acts";
import { ObjectIndex } from "./objects";
import { recents, remember } from "./recents";
import { initialRows, kept, rowsFor, type Searched } from "./search";

const TEXTS = new ProcessTexts(new Map());
const around = { services: ["task-orchestrator", "device-gateway"], showPreferences: () => undefined, showKeys: () => undefined };

function filled(topics: Record<string, unknown>): { live: LiveStore; index: ObjectIndex } {
  const live = new LiveStore();
  live.apply({ type: "snapshot", at: "", topics, events: [] });
  const index = new ObjectIndex(live);
  index.refresh(TEXTS);
  return { live, index };
}

const cell = () =>
  filled({
    "process/p1": process({ id: "p1", name: "Bin picking · order-7", tasks: [task({ id: "urn:ngsi-ld:Task:demo:p1-pick-1" })] }),
    "process/p2": process({ id: "p2", name: "Bin picking · order-8", endedAt: "2026-03-02T08:00:00Z", status: "completed" }),
    "definition/bin-picking": { name: "bin-picking", version: 2, title: "Bin picking", parameters: [], holds: [], deletedVersions: [], translations: {} },
    "alert/a1": alertOf("a1", { subCategory: "gloveSilent" }),
    "glove/glove-1": { glove: "glove-1", person: null },
    "device/urn:ngsi-ld:Device:demo:glove-1": { id: "urn:ngsi-ld:Device:demo:glove-1", category: ["glove"], deviceState: "ok" },
    "device/urn:ngsi-ld:Device:demo:scale-1": { id: "urn:ngsi-ld:Device:demo:scale-1", category: ["sensor"], deviceState: "ok" },
  }).index;

function searched(index: ObjectIndex): Searched {
  return { pages: [], objects: index.entries, entry: (id) => index.entry(id), recent: recents(), around };
}

const names = (query: string, index: ObjectIndex) => rowsFor(query, searched(index)).map(({ name }) => name);

async function signIn(...permissions: string[]): Promise<void> {
  const user = { subject: permissions.join(), name: "Vera", person: null, permissions, isLocal: false, isStation: false };
  vi.stubGlobal("fetch", () => Promise.resolve(new Response(JSON.stringify({ hasAccounts: true, user, csrf: null, provider: null }))));
  await loadSession();
  vi.unstubAllGlobals();
}

beforeEach(async () => {
  localStorage.clear();
  if (!i18next.isInitialized) await initI18n();
  await i18next.loadNamespaces("palette");
  await signIn("read", "performTasks", "acknowledgeAlerts", "runProcesses", "deployProcesses", "configure", "moveRobots");
});

describe("acts", () => {
  it("are offered on the objects on which they are possible", () => {
    const index = cell();
    expect(names("cancel", index)).toContain("Cancel Bin picking · order-7 …");
    expect(names("cancel", index)).not.toContain("Cancel Bin picking · order-8 …");
    expect(names("stop order", index)[0]).toBe("Cancel Bin picking · order-7 …");
    expect(names("start bin", index)[0]).toBe("Start Bin picking …");
    expect(names("acknowledge", index)).toContain("Acknowledge Glove sends no data …");
    expect(names("resume", index)).not.toContain("Resume Bin picking · order-7 …");
  });

  it("are not offered to who may not do them", async () => {
    await signIn("read");
    const index = cell();
    for (const query of ["start bin", "cancel", "pause", "resume", "acknowledge", "upload", "claim", "calibrate glove", "migrate", "add device"]) {
      expect(rowsFor(query, searched(index)).flatMap(({ act }) => (act?.permission === undefined ? [] : [act.id])), query).toEqual([]);
    }
    expect(names("order-7", index)).toEqual(["Bin picking · order-7", "Pick the part"]);
  });

  it("of other parts of the page are offered while they are there", () => {
    const index = cell();
    const remove = addActs([{ id: "wave", icon: () => null, text: () => "Wave", address: "/wave" }]);
    expect(names("wave", index)).toEqual(["Wave"]);
    remove();
    expect(names("wave", index)).toEqual([]);
  });
});

describe("objects", () => {
  it("are listed once, with the page that is made for them", () => {
    const { entries } = cell();
    expect(entries.filter(({ name }) => name === "glove-1").map(({ address }) => address)).toEqual(["/cell/gloves/glove-1"]);
    expect(entries.find(({ name }) => name === "scale-1")?.address).toBe("/cell?find=scale-1");
    expect(entries.find(({ name }) => name === "Pick the part")?.address).toBe("/processes/p1?task=pick-1");
    expect(new Set(entries.map(({ id }) => id)).size).toBe(entries.length);
  });

  it("follow the live store, and keep what has not changed", () => {
    const { live, index } = filled({ "process/p1": process({ id: "p1", name: "First" }), "process/p2": process({ id: "p2", name: "Second" }) });
    const before = index.entry("process/p1");
    live.apply({ type: "batch", at: "", topics: { "process/p2": process({ id: "p2", name: "Second", status: "paused" }), "process/p3": process({ id: "p3", name: "Third" }) }, events: [] });
    index.refresh(TEXTS);
    expect(index.entry("process/p1")).toBe(before);
    expect(index.entry("process/p2")).toMatchObject({ detail: "Paused" });
    expect(index.entry("process/p3")?.name).toBe("Third");
    live.apply({ type: "snapshot", at: "", topics: {}, events: [] });
    index.refresh(TEXTS);
    expect(index.entries).toEqual([]);
  });

  it("keep their place when others arrive for the same query", () => {
    const index = cell();
    const rows = rowsFor("bin", searched(index));
    const later = [...rows].reverse().slice(1);
    const arrived = { ...rows[0], id: "process/p9", name: "Bin picking · order-9" } as (typeof rows)[number];
    expect(kept(rows, [arrived, ...later]).map(({ id }) => id)).toEqual([...rows.map(({ id }) => id), "process/p9"]);
  });
});

describe("what was used lately", () => {
  it("comes first, the last before others, each once, and is that of the user", async () => {
    const index = cell();
    const entry = (id: string) => index.entry(id) ?? expect.fail(id);
    remember(entry("process/p2"));
    remember(entry("process/p1"));
    remember(entry("process/p2"));
    expect(names("bin picking", index).slice(0, 2)).toEqual(["Bin picking · order-8", "Bin picking · order-7"]);
    expect(initialRows(searched(index)).recent.map(({ id }) => id)).toEqual(["process/p2", "process/p1"]);
    await signIn("read");
    expect(recents()).toEqual([]);
  });

  it("is not listed if the user may not see or do it any more", async () => {
    const index = cell();
    remember({ id: "user/1", kind: "user", name: "Olga", address: "/admin/people?view=users&user=1" });
    remember({ id: "act/upload", kind: "act", name: "Upload", address: "/processes/upload" });
    remember({ id: "process/archived", kind: "process", name: "Old", address: "/processes/archived" });
    const mine = recents();
    await signIn("read");
    expect(initialRows({ ...searched(index), recent: mine }).recent.map(({ id }) => id)).toEqual(["process/archived"]);
  });
});
