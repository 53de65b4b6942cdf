import { beforeEach, expect, test } from "vitest";
import { draftOf, keepDraft } from "./drafts";

const draft = { entries: { weight: "12" }, outcome: "ok" as const, note: "" };

beforeEach(() => localStorage.clear());

test("a draft is kept for a person and Task until it is forgotten", () => {
  keepDraft("t-1", "Anna", draft);
  expect(draftOf("t-1", "Anna")).toEqual(draft);
  expect(draftOf("t-1", "Ben")).toBeNull();
  expect(draftOf("t-2", "Anna")).toBeNull();
  keepDraft("t-1", "Anna", null);
  expect(draftOf("t-1", "Anna")).toBeNull();
});

test("the oldest of many drafts is forgotten, and broken storage is no draft", () => {
  for (let nth = 0; nth < 51; nth += 1) keepDraft(`t-${nth}`, "Anna", draft);
  expect(draftOf("t-0", "Anna")).toBeNull();
  expect(draftOf("t-50", "Anna")).toEqual(draft);
  localStorage.setItem("handover.drafts", "{");
  expect(draftOf("t-50", "Anna")).toBeNull();
});
