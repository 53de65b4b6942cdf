import { fireEvent, render, screen } from "@testing-library/react";
import i18next from "i18next";
import { beforeAll, expect, it, vi } from "vitest";
import type { PersonView, StateView, ValueView } from "~/api/generated/human-state";
import { initI18n, setLanguage } from "~/i18n";
import { ConsentForm } from "./ConsentForm";
import { RecordedCard } from "./RecordedCard";
import { VitalSigns } from "./VitalSigns";

const person: PersonView = {
  person: "aino", pseudonym: "P-7f3a", restBpm: 60, maximumBpm: 180, baselineMethod: "age", consent: null, purposes: [], isMonitored: false,
  recording: null, sensors: [], limit: null,
};
const value = (name: string, over: Partial<ValueView> = {}): ValueView => ({
  name, value: 72, unit: "BPM", quality: 0.9, status: "valid", ageS: 1, method: "", isCalibrated: true, disagree: false, sensors: [], ...over,
});

beforeAll(async () => {
  await initI18n();
  await i18next.loadNamespaces(["health"]);
  await setLanguage("en");
});

it("names values that may not be trusted", () => {
  const values = [value("heartRate"), value("spo2", { status: "stale", ageS: 8, isCalibrated: false, value: 97, unit: "P1" }), value("breathingRate", { status: "implausible" })];
  const state: StateView = { person: "aino", pseudonym: "P-7f3a", values, exertion: null, strain: 0, isStrained: false, limit: null };
  const { container } = render(<VitalSigns state={state} silentS={0} isOld={false} />);
  const shown = [...container.querySelectorAll(".vital-sign")].map((each) => [each.getAttribute("data-trust"), each.textContent]);
  expect(shown.map(([trust]) => trust)).toEqual(["valid", "implausible", "stale"]);
  expect(shown[2]?.[1]).toContain("Out of date");
  expect(shown[2]?.[1]).toContain("8 s old");
  expect(shown[2]?.[1]).toContain("Not calibrated");
});

it("shows what is recorded, and asks before it deletes", async () => {
  const sent = vi.fn<typeof fetch>(() => Promise.resolve(new Response(null, { status: 204 })));
  vi.stubGlobal("fetch", sent);
  const onChange = vi.fn();
  render(<RecordedCard person={{ ...person, purposes: ["live", "history"] }} onChange={onChange} onChangeConsent={vi.fn()} onDeletePerson={vi.fn()} />);
  const states = screen.getAllByRole("listitem").map((each) => each.textContent);
  expect(states).toEqual(["Live displayon", "Speed limitsoff", "Historyon", "Context brokeroff", "Broker historyoff", "Recordingsoff"]);
  fireEvent.click(screen.getByRole("button", { name: "Delete the values" }));
  expect(sent).not.toHaveBeenCalled();
  const dialog = screen.getByRole("dialog");
  expect(dialog.textContent).toContain("Delete the values of aino?");
  const confirm = [...dialog.querySelectorAll("button")].find((each) => each.textContent === "Delete the values");
  if (confirm !== undefined) fireEvent.click(confirm);
  await vi.waitFor(() => expect(onChange).toHaveBeenCalled());
  expect(sent.mock.calls[0]?.[0]).toBe("/api/human-state/people/aino/data");
  vi.unstubAllGlobals();
});

it("gives no consent before the form is complete, and sends the chosen purposes", async () => {
  localStorage.clear();
  const sent = vi.fn<typeof fetch>(() => Promise.resolve(new Response("{}", { status: 200, headers: { "Content-Type": "application/json" } })));
  vi.stubGlobal("fetch", sent);
  const onDone = vi.fn();
  render(<ConsentForm person={person} onDone={onDone} />);
  fireEvent.click(screen.getByRole("button", { name: "Give the consent" }));
  expect(sent).not.toHaveBeenCalled();
  expect(screen.getByText("Enter a name")).toBeTruthy();
  fireEvent.change(screen.getByLabelText("Given in the presence of"), { target: { value: "Aino" } });
  fireEvent.click(screen.getByLabelText("Values are kept for the time of retention"));
  fireEvent.click(screen.getByRole("button", { name: "Give the consent" }));
  await vi.waitFor(() => expect(onDone).toHaveBeenCalledWith("aino"));
  const [url, request] = sent.mock.calls[0] ?? [];
  expect(url).toBe("/api/human-state/people/aino/consent");
  expect(JSON.parse(request?.body as string)).toMatchObject({ purposes: ["live", "history"], givenBy: "Aino" });
  vi.unstubAllGlobals();
});
