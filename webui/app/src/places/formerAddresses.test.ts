import { describe, expect, test } from "vitest";
import { presentAddress } from "./formerAddresses";
import { PAGES, pageAt, placeOf, PLACES } from "./places";

const FIRST = { robot: "ur10-1", glove: "glove-1" };
const NOTHING = { robot: undefined, glove: undefined };

/** Each address of the former version, and where it leads. */
const FORMER: readonly (readonly [string, string, string])[] = [
  ["/tasks", "?task=t-1", "/work/tasks?task=t-1"],
  ["/cockpit", "", "/processes/statistics"],
  ["/system", "", "/admin/services"],
  ["/system", "?tab=alerts&alert=urn%3Aa", "/alerts?alert=urn%3Aa"],
  ["/system", "?tab=robots", "/cell/robots"],
  ["/system", "?tab=gloves", "/cell/gloves"],
  ["/system", "?tab=devices", "/cell"],
  ["/system", "?tab=ros", "/cell/ros"],
  ["/system", "?tab=events&level=stop", "/cell/events?level=stop"],
  ["/people", "?view=audit", "/admin/people?view=audit"],
  ["/sensors", "?find=oven", "/cell/devices?find=oven&view=board"],
  ["/cell/sensors", "?show=attention", "/cell/devices?show=attention&view=board"],
  ["/health", "", "/care/health"],
  ["/cases", "?case=treadmill", "/care/cases?case=treadmill"],
  ["/humanoid", "", "/care/exercises"],
  ["/humanoid/vr", "", "/care/exercises/vr"],
  ["/devices", "?device=arm%201&part=history", "/cell/devices/arm%201?part=history"],
  ["/devices", "?add=yes", "/cell/devices?add=yes"],
  ["/alerting", "?add=yes", "/admin/alerts?add=yes"],
  ["/control", "?robot=left", "/cell/robots/left/control"],
  ["/control", "", "/cell/robots/ur10-1/control"],
  ["/calibrate", "?glove=glove-2&step=5", "/cell/gloves/glove-2/calibrate?step=5"],
  ["/test", "?part=accuracy", "/cell/gloves/glove-1/test?part=accuracy"],
  ["/study", "?session=s", "/admin/studies?session=s"],
];

describe("former addresses", () => {
  test.each(FORMER)("%s%s leads to %s", (path, search, to) => {
    expect(presentAddress(path, search, FIRST)).toBe(to);
  });

  test.each(FORMER)("%s%s leads to a page that exists, and to no former address again", (path, search) => {
    const [to = ""] = (presentAddress(path, search, NOTHING) ?? "").split("?");
    const page = pageAt(to);
    expect(page !== undefined && (page.path === to || page.below !== undefined)).toBe(true);
    expect(presentAddress(to, "", FIRST)).toBeNull();
  });

  test("what was never an address leads nowhere", () => {
    expect(presentAddress("/nothing", "", FIRST)).toBeNull();
    expect(presentAddress("/system", "?tab=nothing", FIRST)).toBeNull();
  });
});

describe("places", () => {
  test("each page is found by its path, in its place", () => {
    for (const place of PLACES) {
      for (const page of place.pages) {
        expect(pageAt(page.path)).toBe(page);
        expect(placeOf(pageAt(page.path))).toBe(place);
      }
    }
    expect(pageAt("/cell/robots/ur10-1/control")?.name).toBe("robots");
    expect(pageAt("/processes/p-1")?.name).toBe("processes");
    expect(pageAt("/cells")).toBeUndefined();
  });

  test("no letter leads to two pages", () => {
    const letters = PAGES.flatMap(({ key }) => key ?? []);
    expect(new Set(letters).size).toBe(letters.length);
  });
});
