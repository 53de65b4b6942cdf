/** The audit logs of several services as one list, and the query of its filters. */
import { expect, it } from "vitest";
import { merged, queryOf, servicesOf, type AuditFilter, type AuditView, type Loaded } from "./audit";

const NO_FILTER: AuditFilter = { service: "", subject: "", action: "", resource: "", outcome: "", from: "", to: "" };

function record(service: string, seq: number, minute: number): AuditView {
  const at = `2026-05-04T08:${String(minute).padStart(2, "0")}:00.000Z`;
  return { service, seq, at, subject: "user-1", action: "x", resource: "*", outcome: "done", method: "user", text: null, hash: "", subjectName: null, resourceName: null };
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
  expect(servicesOf({ ...NO_FILTER, service: "study" })).toEqual(["study"]);
});
