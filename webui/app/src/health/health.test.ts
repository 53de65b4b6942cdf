import { describe, expect, it, test } from "vitest";
import type { PersonView, ValueView } from "~/api/generated/human-state";
import { consentFaults, consentState, dateText, endOfDay, numberText, pointsOf, pressureGrid, reasonOf, sensorFault, trustOf, vitalSigns, wavePlace } from "./health";

const value = (over: Partial<ValueView> = {}): ValueView => ({
  name: "heartRate", value: 72, unit: "BPM", quality: 0.9, status: "valid", ageS: 0.4, method: "ecg", isCalibrated: true, disagree: false, sensors: [], ...over,
});

test("a value is trusted while it is valid, good and new", () => {
  expect(trustOf(value(), 0.5)).toBe("valid");
  expect(trustOf(value({ quality: 0.4 }), 0.5)).toBe("weak");
  expect(trustOf(value({ status: "stale" }), 0)).toBe("stale");
  expect(trustOf(value({ status: "implausible" }), 60)).toBe("implausible");
  expect(trustOf(value(), 3.5), "the connection is silent").toBe("stale");
});

test("waveforms of the heart come first, and a small negative number is no minus zero", () => {
  const kinds = ["acceleration", "respiration", "ecg"].sort((a, b) => wavePlace(a, "s").localeCompare(wavePlace(b, "s")));
  expect(kinds).toEqual(["ecg", "respiration", "acceleration"]);
  expect(numberText("edaPhasic", -0.001, "en")).toBe("0");
  expect(numberText("edaPhasic", 0.022, "en")).toBe("0.02");
});

test("vital signs have a fixed order, and values of unknown names come last", () => {
  const state = { person: "aino", pseudonym: "P-1", exertion: null, strain: 0, isStrained: false, limit: null };
  const values = ["zeta", "spo2", "posture", "beta", "breathingRate", "copX", "heartRate"].map((name) => value({ name }));
  expect(vitalSigns({ ...state, values }).map(({ name }) => name)).toEqual(["heartRate", "breathingRate", "spo2", "beta", "zeta"]);
});

test("numbers have the digits of their feature, and shares are percentages", () => {
  expect(numberText("heartRate", 71.6, "en")).toBe("72");
  expect(numberText("skinTemperature", 33.44, "de")).toBe("33,4");
  expect(numberText("exertionLevel", 0.415, "en")).toBe("42%");
  expect(numberText("spo2", 97.4, "en")).toBe("97%");
  expect(numberText("bodyMovement", 4, "de")).toBe("4\u00a0%");
});

test.each([
  ["no heart rate yet", "none", 0],
  ["stopped; a person must reset it (the heart rate is high)", "high", 0],
  ["the heart rate is normal", "normal", 0],
  ["the heart rate is normal, and the limit rises slowly", "rising", 0],
  ["stopped; a person must reset it (no valid heart rate for 12 s)", "silent", 12],
  ["a reason of a later version", "other", 0],
])("the reason %j is known", (reason, key, seconds) => {
  expect(reasonOf({ reason })).toMatchObject({ key, seconds });
});

test("a sensor without contact or link is at fault", () => {
  const sensor = { name: "strap", driver: "simulated", settings: {}, link: "connected", battery: null, hasContact: true, fault: null, problem: "", problemCode: null, problemParameters: null, signals: [], leftOut: [] };
  expect(sensorFault(sensor)).toBeNull();
  expect(sensorFault({ ...sensor, fault: "gap" })).toEqual({ kind: "fault", what: "gap" });
  expect(sensorFault({ ...sensor, hasContact: false, fault: "gap" })).toEqual({ kind: "contact", what: "noContact" });
  expect(sensorFault({ ...sensor, link: "lost", hasContact: false })).toEqual({ kind: "link", what: "lost" });
});

describe("a consent", () => {
  const now = new Date(2026, 4, 4, 12).getTime();
  const fields = { name: "aino", age: "40", ends: "2026-06-03", givenBy: "Aino" };

  it("needs a name, an age, an end within a year, and who was there", () => {
    expect(consentFaults(fields, true, now)).toEqual({});
    expect(consentFaults({ name: "Ä i", age: "x", ends: "2026-05-03", givenBy: " " }, true, now)).toEqual({ name: true, age: true, ends: true, givenBy: true });
    expect(consentFaults({ ...fields, name: "Ä i", age: "" }, false, now), "a known person has both").toEqual({});
    expect(consentFaults({ ...fields, ends: "2028-01-01" }, true, now)).toEqual({ ends: true });
    expect(consentFaults({ ...fields, ends: dateText(now) }, true, now), "today ends tonight").toEqual({});
  });

  it("ends with its day", () => {
    expect(endOfDay("2026-06-03")).toBe(new Date(2026, 5, 3, 23, 59, 59).toISOString());
    expect(endOfDay("2026-02-30")).toBeNull();
    expect(endOfDay("soon")).toBeNull();
  });

  it("is none, valid, ended or withdrawn", () => {
    const consent = { purposes: [], given: "", ends: "", givenBy: "", withdrawn: null };
    const person = { consent: null, purposes: [] } as unknown as PersonView;
    expect(consentState(person)).toBe("none");
    expect(consentState({ ...person, consent })).toBe("ended");
    expect(consentState({ ...person, consent: { ...consent, withdrawn: "2026-05-04T08:00:00Z" } })).toBe("withdrawn");
    expect(consentState({ ...person, consent, purposes: ["live"] })).toBe("valid");
  });
});

test("a chart has the least, the mean and the most of each part", () => {
  const point = { at: "2026-05-04T08:00:00Z", least: 60, mean: 70, most: 90, values: 12 };
  expect(pointsOf([point])).toEqual([{ t: Date.parse(point.at) / 1000, mean: 70, min: 60, max: 90, n: 12 }]);
});

test("a pressure map is placed by the names of its cells", () => {
  const grid = pressureGrid(["r0c0", "r0c1", "r1c0"], [10, 30, null]);
  expect(grid).toEqual({ rows: 2, columns: 2, cells: [[10 / 30, 1], [null, null]], centre: { x: 1.25, y: 0.5 } });
  expect(pressureGrid(["r0c0", "r0c1"], [0, 0])).toMatchObject({ cells: [[0, 0]], centre: null });
  expect(pressureGrid(["left", "right"], [1, 2])).toBeNull();
  expect(pressureGrid([], [])).toBeNull();
});
