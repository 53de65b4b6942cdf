import { act, fireEvent, render, screen, within } from "@testing-library/react";
import userEvent from "@testing-library/user-event";
import { useLayoutEffect, useState } from "react";
import { beforeAll, beforeEach, expect, test, vi } from "vitest";
import { initI18n, setLanguage } from "~/i18n";
import { DataTable, type Column, type Grouping, type Sorting } from "./DataTable";

interface Device {
  id: string;
  kind: string;
  level: number | null;
}

const columns: readonly Column<Device>[] = [
  { id: "id", name: "Device", width: "1fr", sortBy: (device) => device.id, cell: (device) => device.id },
  { id: "level", name: "Level", width: "1fr", isDescendingFirst: true, isNumber: true, sortBy: (device) => device.level, cell: (device) => device.level },
  { id: "kind", name: "Kind", width: "1fr", cell: (device) => device.kind },
];

function Table({ rows, grouping, onOpen, isSelectable = false }: { rows: readonly Device[]; grouping?: Grouping<Device>; onOpen?: (device: Device) => void; isSelectable?: boolean }) {
  const [sorting, setSorting] = useState<Sorting>({ by: "id", isDescending: false });
  const [selected, setSelected] = useState<ReadonlySet<string>>(new Set());
  return (
    <DataTable
      label="Devices"
      rows={rows}
      columns={columns}
      keyOf={(device) => device.id}
      nameOf={(device) => device.id}
      rowHeight={40}
      sorting={sorting}
      onSort={setSorting}
      grouping={grouping}
      {...(isSelectable ? { selected, onSelect: setSelected } : {})}
      {...(onOpen === undefined ? {} : { onOpen })}
    />
  );
}

function devices(...ids: string[]): Device[] {
  return ids.map((id, index) => ({ id, kind: index % 2 === 0 ? "glove" : "robot", level: index === 0 ? null : index }));
}

function shown(): string[] {
  return [...document.querySelectorAll<HTMLElement>(".vgrid__line")].map((row) => row.dataset["key"] ?? "");
}

function sortBy(name: string) {
  fireEvent.click(within(screen.getByRole("columnheader", { name })).getByRole("button"));
}

beforeAll(async () => {
  await initI18n();
  await setLanguage("en");
});

beforeEach(() => {
  // jsdom has no layout.
  vi.spyOn(HTMLElement.prototype, "clientHeight", "get").mockReturnValue(400);
  vi.spyOn(HTMLElement.prototype, "clientWidth", "get").mockReturnValue(800);
  vi.spyOn(HTMLElement.prototype, "offsetHeight", "get").mockReturnValue(40);
});

test("sorts by a column, numbers in texts by value, and rows without a value last", () => {
  render(<Table rows={devices("glove-10", "glove-9", "arm")} />);
  expect(shown()).toEqual(["arm", "glove-9", "glove-10"]);
  sortBy("Device");
  expect(shown()).toEqual(["glove-10", "glove-9", "arm"]);
  expect(screen.getByRole("columnheader", { name: "Device" })).toHaveProperty("ariaSort", "descending");
  sortBy("Level");
  expect(shown()).toEqual(["arm", "glove-9", "glove-10"]);
  sortBy("Level");
  expect(shown()).toEqual(["glove-9", "arm", "glove-10"]);
  expect(within(screen.getByRole("columnheader", { name: "Kind" })).queryByRole("button")).toBeNull();
});

test("has only the visible rows of a long table in the document, and the arrow keys reach all", async () => {
  const opened: string[] = [];
  render(<Table rows={devices(...Array.from({ length: 500 }, (_, index) => `device ${index}`))} onOpen={(device) => opened.push(device.id)} />);
  const table = screen.getByRole("grid", { name: "Devices" });
  expect(table.getAttribute("aria-rowcount")).toBe("501");
  expect(shown().length).toBeLessThan(60);
  const user = userEvent.setup();
  await user.click(screen.getByRole("row", { name: "device 0" }));
  await user.keyboard("{ArrowDown}{ArrowDown}{ArrowUp}{Enter}");
  expect(opened).toEqual(["device 0", "device 1"]);
});

test("a key that is pressed before the effects of a refresh have run moves the focus too", () => {
  // The key arrives after the refreshed rows are in the document and before the effects of that render.
  let press: (() => void) | null = null;
  const Probe = () => {
    useLayoutEffect(() => {
      press?.();
      press = null;
    });
    return null;
  };
  const probed: readonly Column<Device>[] = [{ id: "id", name: "Device", width: "1fr", sortBy: (device) => device.id, cell: (device) => <>{device.id}<Probe /></> }];
  const rows = Array.from({ length: 500 }, (_, index) => ({ id: `device ${index}`, kind: "glove", level: index }));
  const table = (shown: readonly Device[]) => (
    <DataTable label="Devices" rows={shown} columns={probed} keyOf={(device) => device.id} nameOf={(device) => device.id} rowHeight={40} sorting={{ by: "id", isDescending: false }} onSort={() => undefined} />
  );
  const { rerender } = render(table(rows));
  act(() => screen.getByRole("row", { name: "device 0" }).focus());
  press = () => fireEvent.keyDown(screen.getByRole("row", { name: "device 0" }), { key: "End" });
  rerender(table(rows.map((device) => ({ ...device }))));
  expect(press).toBeNull();
  expect(document.activeElement?.getAttribute("aria-label")).toBe("device 499");
});

test("keeps its order while it has the focus, and shows new rows on request", () => {
  const { rerender } = render(<Table rows={devices("b", "c")} />);
  fireEvent.focus(screen.getByRole("row", { name: "b" }));
  rerender(<Table rows={devices("a", "b", "c", "d")} />);
  expect(shown()).toEqual(["b", "c", "d"]);
  fireEvent.click(screen.getByRole("button", { name: "1 new" }));
  expect(shown()).toEqual(["a", "b", "c", "d"]);
});

test("groups stand where their first row stands, with their numbers of rows", () => {
  const grouping = { keyOf: (device: Device) => device.kind, nameOf: (kind: string, count: number) => `${kind} ${count}` };
  render(<Table rows={devices("c", "a", "b")} grouping={grouping} />);
  const lines = [...document.querySelectorAll<HTMLElement>(".vgrid__line, .vgrid__group")];
  expect(lines.map((line) => line.dataset["key"] ?? line.textContent)).toEqual(["robot 1", "a", "glove 2", "b", "c"]);
});

test("Shift selects all rows since the last selected one", async () => {
  render(<Table rows={devices("a", "b", "c", "d")} isSelectable />);
  const user = userEvent.setup();
  await user.click(screen.getByRole("checkbox", { name: "Select a" }));
  await user.keyboard("{Shift>}");
  await user.click(screen.getByRole("checkbox", { name: "Select c" }));
  await user.keyboard("{/Shift}");
  const checked = screen.getAllByRole<HTMLInputElement>("checkbox").filter((box) => box.checked);
  expect(checked.map((box) => box.getAttribute("aria-label"))).toEqual(["Select a", "Select b", "Select c"]);
});
