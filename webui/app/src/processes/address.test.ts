import { expect, it } from "vitest";
import { pathOf, placeOf, type Place } from "./address";

it.each<[string, Place]>([
  ["/processes", { kind: "nothing" }],
  ["/processes/", { kind: "nothing" }],
  ["/processes/bin-picking-7f3a", { kind: "process", id: "bin-picking-7f3a" }],
  ["/processes/definition/bin-picking", { kind: "definition", name: "bin-picking" }],
  ["/processes/definition", { kind: "unknown", path: "/processes/definition" }],
  ["/processes/upload", { kind: "upload" }],
  ["/processes/offers", { kind: "offers" }],
  ["/processes/a/b/c", { kind: "unknown", path: "/processes/a/b/c" }],
  ["/processes/caf%C3%A9", { kind: "process", id: "café" }],
  ["/processes/100%", { kind: "process", id: "100%" }],
])("%s shows what it names", (path, place) => {
  expect(placeOf(path)).toEqual(place);
});

it("leads back to the place that a path was made of", () => {
  for (const place of [{ kind: "process", id: "a/b ?#%" }, { kind: "definition", name: "käsi" }] as const) {
    expect(placeOf(pathOf(place))).toEqual(place);
  }
});
