import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import { listenForKeys, setKeysOn } from "./keys";
import { discardScans, SCAN_GAP_MS } from "./scans";

const SCANS = ["4006381333932", "c", "gc", "g w", " ", "  ", "pscnbd", "https://example.com/?task=1", "(01)04012345"];
const PERSON_MS = 120;

let stops: (() => void)[] = [];
let acts: string[] = [];
let now = 1000;

/** Press a key, `afterMs` after the one before; returns whether the browser would do its default. */
function press(key: string, afterMs: number): boolean {
  now += afterMs;
  vi.advanceTimersByTime(afterMs);
  const target = document.activeElement ?? document.body;
  const send = (type: string) => {
    const event = new KeyboardEvent(type, { key, bubbles: true, cancelable: true });
    Object.defineProperty(event, "timeStamp", { value: now });
    return target.dispatchEvent(event);
  };
  const isDefault = send("keydown");
  const isReleased = send("keyup");
  // What browsers do and jsdom does not.
  if (target instanceof HTMLButtonElement && ((key === "Enter" && isDefault) || (key === " " && isDefault && isReleased))) target.click();
  if (target instanceof HTMLInputElement && key === "Enter" && isDefault) target.form?.requestSubmit();
  return isDefault;
}

function scan(text: string, gapMs = 5): boolean[] {
  const defaults = [...Array.from(text), "Enter"].map((key, index) => press(key, index === 0 ? 1000 : gapMs));
  vi.advanceTimersByTime(1000);
  return defaults;
}

beforeEach(() => {
  vi.useFakeTimers();
  document.body.innerHTML = `
    <button id="act">Complete</button>
    <form><input id="field"><input id="badge" data-takes-scans><select id="list"><option>one</option><option>4 four</option><option>cart</option></select><textarea id="note"></textarea></form>
    <input id="box" type="checkbox">`;
  acts = [];
  const note = (name: string) => () => acts.push(name);
  document.getElementById("act")?.addEventListener("click", note("click"));
  document.getElementById("list")?.addEventListener("change", note("change"));
  document.getElementById("box")?.addEventListener("change", note("tick"));
  document.querySelector("form")?.addEventListener("submit", (event) => {
    event.preventDefault();
    acts.push("submit");
  });
  stops = [discardScans(), listenForKeys(["c", "w", "4", "Escape"].map((key) => ({ key, act: note(`go ${key}`) })))];
});

afterEach(() => {
  stops.forEach((stop) => stop());
  setKeysOn(true);
  vi.useRealTimers();
});

describe("a scan", () => {
  test.each(SCANS.flatMap((text) => ["act", "field", "list", "note", "box", "body"].flatMap((id) => [1, SCAN_GAP_MS - 1].map((gapMs) => [text, id, gapMs] as const))))(
    "%j with the focus on %s, characters %i ms apart, does nothing",
    (text, id, gapMs) => {
      document.getElementById(id)?.focus();
      scan(text, gapMs);
      scan(text, gapMs);
      expect(acts).toEqual([]);
    },
  );

  test("goes into the field that has the input, without submitting", () => {
    document.getElementById("field")?.focus();
    expect(scan("4006381333932")).toEqual([...Array<boolean>(13).fill(true), false]);
  });

  test("submits the field that is made for it", () => {
    document.getElementById("badge")?.focus();
    scan("B-anna-1");
    expect(acts).toEqual(["submit"]);
  });
});

describe("a person", () => {
  test.each(["Enter", " "])("presses what is focused with %j", (key) => {
    document.getElementById("act")?.focus();
    press("x", 1000);
    press(key, PERSON_MS);
    vi.advanceTimersByTime(1000);
    expect(acts).toEqual(["click"]);
  });

  test("submits a form after typing", () => {
    document.getElementById("field")?.focus();
    for (const letter of "anna") press(letter, PERSON_MS);
    press("Enter", 2 * PERSON_MS);
    expect(acts).toEqual(["submit"]);
  });

  test("chooses from a list by its first letters", () => {
    const list = document.getElementById("list") as HTMLSelectElement;
    list.focus();
    press("c", 1000);
    press("a", PERSON_MS);
    vi.advanceTimersByTime(1000);
    expect(list.value).toBe("cart");
  });

  test("goes to a page by g and a letter, and by nothing else", () => {
    press("c", 1000);
    press("w", PERSON_MS);
    press("g", 1000);
    press("x", PERSON_MS);
    press("c", PERSON_MS);
    expect(acts).toEqual([]);
    press("g", 1000);
    press("c", PERSON_MS);
    press("Escape", PERSON_MS);
    expect(acts).toEqual(["go c", "go Escape"]);
  });

  test("does not go to a page while something has the input, or when keys are switched off", () => {
    document.getElementById("field")?.focus();
    press("g", 1000);
    press("c", PERSON_MS);
    document.getElementById("act")?.focus();
    document.body.insertAdjacentHTML("beforeend", '<div role="dialog"></div>');
    press("g", 1000);
    press("c", PERSON_MS);
    document.querySelector("[role=dialog]")?.remove();
    setKeysOn(false);
    press("g", 1000);
    press("c", PERSON_MS);
    expect(acts).toEqual([]);
  });
});

/** Files that handle keys, and what a key can do there: nothing that confirms, starts, moves or deletes by a plain character. */
const HANDLERS: Readonly<Record<string, string>> = {
  "calibrate/FingerColumn.tsx": "a field: Enter applies, arrows step its own draft",
  "control/DevicesPanel.tsx": "assigns a key after a press of its button",
  "control/HoldButton.tsx": "a hold with Enter",
  "control/useControl.ts": "a hold; keys held as briefly as by a scanner do not count",
  "design/table/VirtualGrid.tsx": "a focused row: arrows, Space selects, Enter opens",
  "hand/GesturePicker.tsx": "Enter in the search chooses the only match",
  "humanoid/Humanoid3d.tsx": "turns the view",
  "humanoid/vr/VrPage.tsx": "the focused view: arrows, Space closes the hand, Enter presses the button at the pointer",
  "palette/Palette.tsx": "the field of the search: arrows choose, Enter opens what is chosen or its question",
  "palette/PaletteButton.tsx": "Ctrl or Cmd with K opens the search",
  "processes/diagram/Diagram.tsx": "moves the view",
  "processes/incidents/Incidents.tsx": "Escape leaves a choice",
  "robot3d/Robot3d.tsx": "turns the view",
  "session/StationMenu.tsx": "only sees that somebody is there",
  "shell/Rail.tsx": "Escape closes a menu",
  "shell/keys.tsx": "navigation: g, then a letter",
  "shell/scans.ts": "discards scans",
  "study/TlxForm.tsx": "Space and Enter mark a focused scale",
  "tasks/ResultForm.tsx": "Ctrl+Enter in the form",
  "work/Kiosk.tsx": "Escape asks whether the navigation is shown",
};

test("every handler of keys is known", () => {
  const sources = import.meta.glob<string>("/src/**/*.{ts,tsx}", { query: "?raw", import: "default", eager: true });
  const handling = Object.entries(sources)
    .filter(([path, text]) => !/\.test\.tsx?$/.test(path) && /onKey(Down|Up|Press)(Capture)?=|addEventListener\(\s*["']key(down|up|press)/.test(text))
    .map(([path]) => path.replace("/src/", ""));
  expect(handling.sort()).toEqual(Object.keys(HANDLERS).sort());
});
