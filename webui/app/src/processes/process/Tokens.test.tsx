import { fireEvent, render, screen } from "@testing-library/react";
import i18next from "i18next";
import { beforeAll, expect, it, vi } from "vitest";
import type { TokenView } from "~/api/generated/task-orchestrator";
import { initI18n, setLanguage } from "~/i18n";
import { process, task } from "~/testing/views";
import { NO_ELEMENTS } from "../diagram/elements";
import { Tokens } from "./Tokens";

beforeAll(async () => {
  await initI18n();
  await i18next.loadNamespaces(["processes"]);
  await setLanguage("en");
});

const token = (over: Partial<TokenView>): TokenView => ({ token: "1", element: "pick", name: "Pick", state: "work", instance: "", task: null, ...over });

function rows(): string[][] {
  return screen.getAllByRole("row").slice(1).map((row) => [...row.children].map(({ textContent }) => textContent));
}

it("lists two tokens at one step as two, each with its instance, its state and its Task", () => {
  const first = task({ id: "urn:ngsi-ld:Task:demo:p-pick-1", visit: 3 });
  const onPick = vi.fn();
  const tokens = [token({ task: first.id, instance: "1/2: left" }), token({ token: "2", instance: "2/2: right", state: "incident" }), token({ token: "3", element: "wait", name: "", state: "waiting" })];
  render(<Tokens process={process({ tokens, tasks: [first] })} elements={NO_ELEMENTS} onPick={onPick} />);
  expect(rows()).toEqual([
    ["Pick", "1/2: left", "Task is performed", "Pick the part"],
    ["Pick", "2/2: right", "Incident: cannot continue", ""],
    ["wait", "", "Waits for an event", ""],
  ]);
  fireEvent.click(screen.getByRole("button", { name: "Pick the part" }));
  expect(onPick).toHaveBeenCalledWith("pick-3");
});

it("says that a process without tokens has ended", () => {
  const { container } = render(<Tokens process={process()} elements={NO_ELEMENTS} onPick={vi.fn()} />);
  expect(container.textContent).toBe("No token: the process has ended.");
});
