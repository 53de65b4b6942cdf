import { expect, test } from "vitest";
import type { MappingEntry, UsedNameView } from "~/api/generated/task-orchestrator";
import { applied, draftOf, entryOf, NO_CHANGES, unmapped, withChange, type Draft } from "./mapping";

const GRIP: MappingEntry = { kind: "topic", name: "grip", resource: "Device:ur10-1" };
const WELD: MappingEntry = { kind: "candidateGroup", name: "welders", role: "welder" };
const DRAFT: Draft = { kind: "lane", name: "Logistics", target: "skills", value: "drive, load", definition: "", parameters: "" };

test("changes are kept when somebody else has changed the mapping", () => {
  const changes = withChange(withChange(NO_CHANGES, GRIP, { ...GRIP, resource: "Device:ur10-2" }), WELD, null);
  expect(applied([GRIP, WELD] as never, changes)).toEqual([{ ...GRIP, resource: "Device:ur10-2" }]);
  const other = { kind: "lane", name: "Store", role: "store" } as const;
  expect(applied([GRIP, other] as never, changes)).toEqual([other, { ...GRIP, resource: "Device:ur10-2" }]);
});

test("another name is another entry", () => {
  const changes = withChange(NO_CHANGES, GRIP, { ...GRIP, name: "hold" });
  expect(applied([GRIP] as never, changes).map((entry) => entry.name)).toEqual(["hold"]);
});

test("an entry has a name and one performer", () => {
  expect(entryOf(DRAFT)).toEqual({ kind: "lane", name: "Logistics", skills: ["drive", "load"] });
  expect(entryOf({ ...DRAFT, target: "resource", value: "Device:ur10-1", parameters: '{"force_n": 20}' })).toEqual({
    kind: "lane", name: "Logistics", resource: "Device:ur10-1", parameters: { force_n: 20 },
  });
  for (const bad of [{ name: " " }, { value: " , " }, { parameters: "[1]" }, { target: "resource", value: "the robot" }] as Partial<Draft>[]) {
    expect(entryOf({ ...DRAFT, ...bad })).toBeNull();
  }
  expect(entryOf(draftOf(WELD))).toEqual(WELD);
});

test("a name is unmapped until an entry is added", () => {
  const used: UsedNameView = { kind: "topic", name: "grip", performer: null, activities: [] };
  expect(unmapped([used], [WELD])).toEqual([used]);
  expect(unmapped([used], [WELD, GRIP])).toEqual([]);
});
