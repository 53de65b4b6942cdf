import { fireEvent, render, screen } from "@testing-library/react";
import i18next from "i18next";
import { afterEach, beforeAll, expect, it, vi } from "vitest";
import type { DefinitionView } from "~/api/generated/task-orchestrator";
import { initI18n, setLanguage } from "~/i18n";
import { Holds } from "./Holds";

beforeAll(async () => {
  await initI18n();
  await i18next.loadNamespaces(["processes"]);
  await setLanguage("en");
});

afterEach(() => vi.unstubAllGlobals());

const definition: DefinitionView = { name: "bin-picking", version: 1, label: null, title: "Bin picking", deployedAt: "2026-03-02T08:00:00Z", parameters: [], holds: [], deletedVersions: [], translations: {} };

it.each([
  [204, null, 1, "closed"],
  [409, '{"status": 409, "title": "Processes run", "detail": "2 processes run"}', 0, "open"],
])("deletes a definition after a question, which stays open with the reason if it is refused (%s)", async (status, body, deleted, after) => {
  const fetched = vi.fn<(path: string, options: RequestInit) => Promise<Response>>(() => Promise.resolve(new Response(body, { status, headers: { "Content-Type": "application/problem+json" } })));
  vi.stubGlobal("fetch", fetched);
  const onDeleted = vi.fn();
  render(<Holds definition={definition} newest={1} onChanged={vi.fn()} onDeleted={onDeleted} />);
  fireEvent.click(screen.getByRole("button", { name: "Delete Bin picking" }));
  expect(fetched).not.toHaveBeenCalled();
  fireEvent.change(screen.getByLabelText("Reason", { exact: false }), { target: { value: "old & slow" } });
  fireEvent.change(screen.getByLabelText("Your name", { exact: false }), { target: { value: "Ann" } });
  fireEvent.click(screen.getByRole("button", { name: "Delete Bin picking" }));
  await vi.waitFor(() => expect(fetched).toHaveBeenCalledOnce());
  expect(fetched.mock.calls[0]?.[0]).toBe("/api/task-orchestrator/definitions/bin-picking?by=Ann&why=old+%26+slow");
  expect(fetched.mock.calls[0]?.[1].method).toBe("DELETE");
  if (after === "open") await screen.findByText("2 processes run", { exact: false });
  else await vi.waitFor(() => expect(screen.queryByRole("dialog")).toBeNull());
  expect(onDeleted).toHaveBeenCalledTimes(deleted);
});

it("deletes an earlier version by itself, and offers it for no other one", async () => {
  const fetched = vi.fn<(path: string) => Promise<Response>>(() => Promise.resolve(new Response(null, { status: 204 })));
  vi.stubGlobal("fetch", fetched);
  const onChanged = vi.fn();
  const { rerender } = render(<Holds definition={definition} newest={2} onChanged={onChanged} onDeleted={vi.fn()} />);
  fireEvent.click(screen.getByRole("button", { name: "Delete version 1" }));
  fireEvent.change(screen.getByLabelText("Reason", { exact: false }), { target: { value: "old" } });
  fireEvent.change(screen.getByLabelText("Your name", { exact: false }), { target: { value: "Ann" } });
  fireEvent.click(screen.getByRole("button", { name: "Delete version 1" }));
  await vi.waitFor(() => expect(onChanged).toHaveBeenCalledOnce());
  expect(fetched.mock.calls[0]?.[0]).toBe("/api/task-orchestrator/definitions/bin-picking/versions/1?by=Ann&why=old");
  rerender(<Holds definition={{ ...definition, deletedVersions: [1] }} newest={2} onChanged={onChanged} onDeleted={vi.fn()} />);
  expect(screen.queryByRole("button", { name: "Delete version 1" })).toBeNull();
  screen.getByText("Version 1 is deleted");
  rerender(<Holds definition={definition} newest={1} onChanged={onChanged} onDeleted={vi.fn()} />);
  expect(screen.queryByRole("button", { name: "Delete version 1" })).toBeNull();
});
