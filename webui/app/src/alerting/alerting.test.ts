/** Rules, routes and channels come through their forms as they were. */
import { describe, expect, it } from "vitest";
import type { Channel, Route, Rule } from "./api";
import { draftOfChannel, draftOfRoute, enteredChannel, enteredRoute, fieldsOfChannel, fieldsOfRoute } from "./route";
import { checkOf, draftOfRule, enteredRule, fieldsOfRule, fits, withCheck } from "./rule";

const t = (key: string) => key;

const RULES: Rule[] = [
  { device: "oven-*", value: "temperature", check: { type: "limits", minimum: -5, maximum: 80, hysteresis: 2 }, severity: "high", forS: 30, clearAfterS: 10, description: "Open the oven", enabled: true },
  { device: "*", value: "*", check: { type: "silence", afterS: 120 }, severity: "low", enabled: false, startProcess: { definition: "inspect", parameters: { robot: "ur10-1" }, cooldownS: 60 } },
  { device: "a", value: "b", check: { type: "rateOfChange", maxPerS: 2, overS: 5, hysteresis: 0.4 }, severity: "medium", enabled: true },
  { device: "a", value: "b", check: { type: "seasonal", threshold: 3, period: "week", intervalMin: 60, historyDays: 90, minimumPeriods: 4, minimumDeviation: 0.5, hysteresis: 0.3 }, severity: "medium", enabled: true },
];

describe("a rule", () => {
  it.each(RULES)("with the check $check.type is the same after the form", (rule) => {
    const fields = fieldsOfRule(t, rule.check.type ?? "limits", ["inspect", "other"]);
    expect(enteredRule(fields, draftOfRule(fields, rule), rule)).toEqual({ rule, faults: {} });
  });

  it("with limits needs one of them", () => {
    const fields = fieldsOfRule(t, "limits", []);
    expect(enteredRule(fields, draftOfRule(fields, null), null).faults).toEqual({ "check.minimum": { code: "required" } });
  });

  it("loses the numbers of the check that it had before", () => {
    const fields = fieldsOfRule(t, "limits", []);
    const draft = { ...draftOfRule(fields, RULES[0] ?? null), "check.type": "3" };
    const changed = withCheck(t, draft);
    expect(checkOf(changed)).toBe("zScore");
    expect(enteredRule(fieldsOfRule(t, "zScore", []), changed, RULES[0] ?? null).rule.check).toEqual({ type: "zScore", threshold: 4, window: 300 });
  });

  it("with parameters of a process needs its definition", () => {
    const fields = fieldsOfRule(t, "limits", []);
    const draft = { ...draftOfRule(fields, RULES[0] ?? null), "startProcess.parameters": "{}" };
    expect(Object.keys(enteredRule(fields, draft, null).faults)).toEqual(["startProcess.definition"]);
  });
});

it("compares names with patterns as the gateway does", () => {
  expect(["oven-1", "oven-", "my-oven-1"].map((name) => fits("oven-*", name))).toEqual([true, true, false]);
  expect(fits("a.b", "axb")).toBe(false);
  expect(fits("o?en", "oven")).toBe(true);
});

it("a route is the same after the form", () => {
  const route: Route = {
    channels: ["night", "team"], minimumSeverity: "low", categories: ["device", "task"], subCategories: [], sources: ["*:ur10-*"], places: [], timeZone: "Europe/Berlin",
    hours: [{ days: ["mon", "fri"], begin: "08:00:00", end: "17:30:00" }], quietHours: [], urgentSeverity: "critical", escalations: [{ afterS: 300, channels: ["night"] }], sendCleared: false, enabled: true,
  };
  const fields = fieldsOfRoute(t, ["night", "team"]);
  const { route: after, faults } = enteredRoute(fields, draftOfRoute(fields, route));
  expect(faults).toEqual({});
  expect(after).toEqual({ ...route, hours: [{ days: ["mon", "fri"], begin: "08:00", end: "17:30" }] });
});

it.each<Channel>([
  { type: "mail", to: ["anna@example.org", "ben@example.org"], throttle: { maximum: 5, perS: 60 } },
  { type: "webhook", url: "https://example.org/hook", throttle: { maximum: 20, perS: 600 } },
])("a channel of the type $type is the same after the form", (channel) => {
  const fields = fieldsOfChannel(t, channel.type ?? "mail");
  expect(enteredChannel(fields, draftOfChannel(fields, channel))).toEqual({ channel, faults: {} });
});

it("the secret of a webhook is never in the form", () => {
  const fields = fieldsOfChannel(t, "webhook");
  expect(draftOfChannel(fields, { type: "webhook", url: "https://example.org", secret: "**********" })["secret"]).toBe("");
});
