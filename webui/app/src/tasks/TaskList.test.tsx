import { render, screen } from "@testing-library/react";
import userEvent from "@testing-library/user-event";
import { createRef } from "react";
import { beforeAll, beforeEach, expect, test, vi } from "vitest";
import { initI18n, setLanguage } from "~/i18n";
import type { TasklistView } from "~/live/messages";
import { at, listedTask } from "~/testing/views";
import { listedTasks } from "./list";
import { TaskList } from "./TaskList";

const WHO = { name: "Anna", groups: [] };

function task(nth: number): TasklistView {
  return listedTask({ id: `urn:ngsi-ld:Task:demo:p-${nth}-weigh-1`, name: `Weigh ${nth}`, process: `p-${nth}`, claimedBy: nth % 2 === 0 ? "Anna" : null, since: at(nth) });
}

beforeAll(async () => {
  await initI18n();
  await setLanguage("en");
});

beforeEach(() => {
  // jsdom has no layout.
  vi.spyOn(HTMLElement.prototype, "clientHeight", "get").mockReturnValue(600);
  vi.spyOn(HTMLElement.prototype, "clientWidth", "get").mockReturnValue(400);
  vi.spyOn(HTMLElement.prototype, "offsetHeight", "get").mockReturnValue(92);
});

test("2,000 Tasks: the document has the visible ones, and the keyboard reaches all", async () => {
  const opened: string[] = [];
  const tasks = listedTasks(Array.from({ length: 2000 }, (_, nth) => task(nth)), []);
  render(<TaskList tasks={tasks} who={WHO} chosen="" onChoose={(one) => opened.push(one)} onIdentify={() => undefined} searchRef={createRef()} />);
  const grid = await screen.findByRole("grid", { name: "Open tasks for people" });
  expect(grid.getAttribute("aria-rowcount")).toBe("2000");
  expect(screen.getAllByRole("row").length).toBeLessThan(60);
  expect(screen.getByRole("radio", { name: "Mine 1000" })).toBeTruthy();
  const user = userEvent.setup();
  await user.click(screen.getByRole("row", { name: "Weigh 0, Claimed by Anna" }));
  await user.keyboard("{ArrowDown}{ArrowDown}{Enter}");
  expect(opened).toEqual(["p-0-weigh-1", "p-2-weigh-1"]);
});
