import { render, screen } from "@testing-library/react";
import userEvent from "@testing-library/user-event";
import { useState } from "react";
import { beforeAll, expect, test } from "vitest";
import type { FormField } from "~/api/generated/task-orchestrator";
import { initI18n, setLanguage } from "~/i18n";
import { field } from "./field";
import type { Draft } from "./form";
import { FormFields } from "./FormFields";

beforeAll(async () => {
  await initI18n();
  await setLanguage("en");
});

function Form({ fields, faults = {}, onDraft }: { fields: readonly FormField[]; faults?: Record<string, string>; onDraft: (draft: Draft) => void }) {
  const [draft, setDraft] = useState<Draft>({});
  return (
    <FormFields
      fields={fields}
      draft={draft}
      faults={faults}
      onChange={(path, entry) => {
        const after = { ...draft, [path]: entry };
        setDraft(after);
        onDraft(after);
      }}
    />
  );
}

test("every kind has a control with its label, and what is only shown has none", async () => {
  const options = [{ value: "r", label: "Red" }];
  render(
    <Form
      onDraft={() => undefined}
      fields={[
        field({ path: "text", kind: "text", label: "Text", isRequired: true }),
        field({ path: "more", kind: "multiline", label: "More" }),
        field({ path: "weight", kind: "number", label: "Weight", unit: "kg" }),
        field({ path: "good", kind: "boolean", label: "Good" }),
        field({ path: "colour", kind: "choice", label: "Colour", options }),
        field({ path: "tags", kind: "choices", label: "Tags", options }),
        field({ path: "day", kind: "date", label: "Day" }),
        field({ path: "#n", kind: "note", label: "# Read\n**this** [page](https://example.org)\n- first" }),
        field({ path: "#t", kind: "table", label: "Parts", columns: [{ key: "id", label: "Id" }], initial: [{ id: 7 }] }),
        field({ path: "twice", kind: "computed", label: "Twice", initial: 8 }),
      ]}
    />,
  );
  expect(await screen.findByRole("textbox", { name: "Text (required)" })).toBeTruthy();
  expect(screen.getByRole("textbox", { name: "Weight (kg)" })).toBeTruthy();
  expect(screen.getByRole("checkbox", { name: "Good" })).toBeTruthy();
  expect(screen.getByRole("combobox", { name: "Colour" })).toBeTruthy();
  expect(screen.getByRole("group", { name: "Tags" })).toBeTruthy();
  expect(screen.getByLabelText("Day")).toHaveProperty("type", "date");
  expect(screen.getByRole("heading", { name: "Read" })).toBeTruthy();
  expect(screen.getByRole("link", { name: "page" })).toHaveProperty("href", "https://example.org/");
  expect(screen.getByRole("cell", { name: "7" })).toBeTruthy();
  expect(screen.getByRole("status").textContent).toBe("8");
});

test("items of a list are added, filled and removed; a fault stands at its field", async () => {
  let last: Draft = {};
  const mm = field({ path: "mm", kind: "number", label: "Diameter" });
  render(<Form fields={[field({ path: "holes", kind: "list", label: "Holes", fields: [mm] })]} faults={{ "holes.0.mm": "Enter 3 or more." }} onDraft={(draft) => (last = draft)} />);
  const user = userEvent.setup();
  await user.click(await screen.findByRole("button", { name: "Add an item" }));
  await user.type(screen.getByRole("textbox", { name: "Diameter" }), "2");
  expect(last).toEqual({ holes: [{ mm: "2" }] });
  expect(screen.getByText("Enter 3 or more.")).toBeTruthy();
  await user.click(screen.getByRole("button", { name: "Remove item 1" }));
  expect(last).toEqual({ holes: [] });
});
