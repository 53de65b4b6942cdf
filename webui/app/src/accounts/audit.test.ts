/** The audit logs of several services as one list, and the query of its filters. */
import { expect, it, vi } from "vitest";
import { csvOf, exported, merged, outcomeOf, queryOf, routeOf, servicesOf, unnamedKind, type AuditFilter, type AuditView, type Loaded } from "./audit";

const NO_FILTER: AuditFilter = { service: "", subject: "", action: "", resource: "", outcome: "", from: "", to: "" };

function record(service: string, seq: number, minute: number): AuditView {
  const at = `2026-05-04T08:${String(minute).padStart(2, "0")}:00.000Z`;
  return { service, seq, at, subject: "user-1", action: "x", resource: "*", outcome: "done", method: "user", text: null, hash: "", intent: null, endedBy: null, subjectName: null, resourceName: null };
}

function loaded(service: Loaded["service"], before: number | null, ...minutes: number[]): Loaded {
  return { service, records: minutes.map((minute) => record(service, minute, minute)), before, failure: null };
}

it("shows nothing older than what a service with more records has loaded", () => {
  const first = [loaded("accounts", 20, 50, 40, 30), loaded("study", null, 45, 10)];
  expect(merged([first]).map(({ seq }) => seq)).toEqual([50, 45, 40, 30]);
  const second = [loaded("accounts", null, 20, 5)];
  expect(merged([first, second]).map(({ seq }) => seq)).toEqual([50, 45, 40, 30, 20, 10, 5]);
});

it("asks the chosen service for whole days of the reader", () => {
  expect(queryOf(NO_FILTER)).toBe("");
  const query = new URLSearchParams(queryOf({ ...NO_FILTER, resource: " ur10-1 ", outcome: "refused", from: "2026-05-04", to: "2026-05-04" }));
  expect([query.get("resource"), query.get("outcome")]).toEqual(["ur10-1", "refused"]);
  expect(Number(query.get("until")) - Number(query.get("since"))).toBe(86_400_000);
  expect(servicesOf({ ...NO_FILTER, service: "study" }, [])).toEqual(["study"]);
});

it("reads method and words of a route, and leaves other actions as they are", () => {
  expect(routeOf("POST /tasks/{task_id}/complete")).toEqual({ method: "POST", words: ["tasks", "complete"] });
  expect(routeOf("PATCH entities/{id}/attrs")).toEqual({ method: "PATCH", words: ["entities", "attrs"] });
  expect(routeOf("grant.added")).toBeNull();
});

it("writes a table that a spreadsheet reads and does not run", () => {
  const [head, line] = csvOf([{ ...record("study", 1, 1), text: '=1+1, "x"', subjectName: "Anna" }]).split("\r\n");
  expect(head?.startsWith("\uFEFFservice,seq,at,subject")).toBe(true);
  expect(line).toBe('study,1,2026-05-04T08:01:00.000Z,user-1,x,*,done,user,"\'=1+1, ""x""",,,,Anna,');
});

it("distinguishes an intent without an outcome", () => {
  expect(outcomeOf({ outcome: "intended", endedBy: null })).toBe("unknown");
  expect(outcomeOf({ outcome: "intended", endedBy: 7 })).toBe("intended");
  expect(outcomeOf({ outcome: "done", endedBy: null })).toBe("done");
});

it("asks services that an installation may lack while they run, or by name", () => {
  expect(servicesOf(NO_FILTER, ["accounts"])).not.toContain("human-state");
  expect(servicesOf(NO_FILTER, ["human-state"])).toContain("human-state");
  expect(servicesOf({ ...NO_FILTER, service: "ros-bridge" }, [])).toEqual(["ros-bridge"]);
});

it("exports what it can read, and names the services that are away", async () => {
  const answers: Record<string, Response> = {
    "/api/accounts/audit/export?format=json": Response.json([record("accounts", 2, 20), record("accounts", 1, 10)]),
    "/api/study/audit/export?format=json": Response.json({ title: "Bad gateway", detail: "study does not answer", status: 502 }, { status: 502 }),
  };
  vi.stubGlobal("fetch", (path: string) => Promise.resolve(answers[path]?.clone()));
  try {
    const file = await exported(NO_FILTER, ["accounts", "study"], "json", new Map([["user-1", "Anna"]]));
    expect(file.name).toBe("audit-without-study.json");
    expect(file.missing).toEqual([{ service: "study", failure: "Study does not answer" }]);
    expect((JSON.parse(file.text) as AuditView[]).map(({ seq, subjectName }) => [seq, subjectName])).toEqual([[1, "Anna"], [2, "Anna"]]);
    await expect(exported(NO_FILTER, ["study"], "csv", new Map())).rejects.toThrow("Study does not answer");
  } finally {
    vi.unstubAllGlobals();
  }
});

it.each([
  ["link-0a1b2c3d4e5f6071", "link"],
  ["user-0a1b2c3d4e5f", "user"],
  ["script-0a1b2c3d4e5f", "token"],
  ["somebody", "other"],
])("says of %s what it was when its name is forgotten", (subject, kind) => {
  expect(unnamedKind(subject)).toBe(kind);
});
