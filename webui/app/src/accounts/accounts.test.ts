/** The words of accounts: grants by role, devices of sessions, drafts of grants, refusals. */
import i18next from "i18next";
import { beforeAll, describe, expect, it } from "vitest";
import rights from "~/i18n/en/rights.json";
import roles from "~/i18n/en/roles.json";
import { missingRight } from "~/session/rights";
import { byRole, deviceName, resourceName } from "./accounts";
import { grantsOf, NEW_DRAFT, resourcesOf } from "./grants";

const UR10 = "urn:ngsi-ld:Device:demo:ur10-1";
const NAO = "urn:ngsi-ld:Device:demo:nao-1";

describe("grants", () => {
  it("are listed by role, the weakest role first", () => {
    const grants = [{ role: "admin", resource: "*" }, { role: "engineer", resource: UR10 }, { role: "engineer", resource: NAO }];
    expect(byRole(grants).map(({ role, grants: of }) => [role, of.map(({ resource }) => resourceName(resource))])).toEqual([
      ["engineer", ["ur10-1", "nao-1"]],
      ["admin", ["*"]],
    ]);
  });

  it("of a performer, which the page does not offer, come last", () => {
    const grants = [{ role: "performer", resource: NAO }, { role: "admin", resource: "*" }];
    expect(byRole(grants).map(({ role }) => role)).toEqual(["admin", "performer"]);
  });

  it("are one for each chosen resource, and none while the draft is incomplete", () => {
    expect(grantsOf({ ...NEW_DRAFT, role: "engineer", scope: "some", chosen: new Set([UR10, NAO]) })).toEqual([
      { role: "engineer", resource: UR10 },
      { role: "engineer", resource: NAO },
    ]);
    expect(grantsOf({ ...NEW_DRAFT, scope: "some" })).toEqual([]);
    expect(grantsOf({ ...NEW_DRAFT, scope: "pattern", pattern: " " })).toEqual([]);
    expect(grantsOf({ ...NEW_DRAFT, scope: "pattern", pattern: " *:ur10-* " })).toEqual([{ role: "operator", resource: "*:ur10-*" }]);
    expect(grantsOf(NEW_DRAFT)).toEqual([{ role: "operator", resource: "*" }]);
  });

  it("are offered for devices first, in the order of their numbers", () => {
    const entities = [
      { id: "urn:ngsi-ld:ProcessDefinition:demo:bin-picking", type: "ProcessDefinition" },
      { id: "urn:ngsi-ld:Device:demo:glove-10", type: "Device" },
      { id: "urn:ngsi-ld:Device:demo:glove-9", type: "Device" },
      { id: "urn:ngsi-ld:Task:demo:1", type: "Task" },
    ];
    expect(resourcesOf(entities).map(({ name }) => name)).toEqual(["glove-9", "glove-10", "bin-picking"]);
  });
});

it("names the browser and the system of a session", () => {
  expect(deviceName("Mozilla/5.0 (X11; Linux x86_64; rv:140.0) Gecko/20100101 Firefox/140.0")).toBe("Firefox, Linux");
  expect(deviceName("Mozilla/5.0 (Linux; Android 15) AppleWebKit/537.36 Chrome/140.0 Mobile Safari/537.36")).toBe("Chrome, Android");
  expect(deviceName("Mozilla/5.0 (iPhone; CPU iPhone OS 18_0 like Mac OS X) Version/18.0 Safari/604.1")).toBe("Safari, iPhone");
  expect(deviceName("python-httpx/0.28")).toBe("python-httpx");
  expect(deviceName("")).toBe("");
});

describe("a refusal", () => {
  beforeAll(() => i18next.init({ lng: "en", resources: { en: { rights, roles } } }));

  it("names the missing permission, its resource, and the roles that have it", () => {
    const text = missingRight({ permission: "moveRobots", resource: UR10, roles: ["engineer"] });
    expect(text).toContain("Move robots");
    expect(text).toContain("ur10-1");
    expect(text).toContain("Engineer");
    expect(missingRight({ permission: "readAudit", resource: "*", roles: ["admin"] })).not.toContain("*");
  });

  it("keeps the text of other errors", () => {
    expect(missingRight({ detail: "the password is wrong" })).toBeNull();
    expect(missingRight({ permission: "unknown" })).toBeNull();
  });
});
