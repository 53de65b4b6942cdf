/** How long the palette takes with 10 000 objects: `npm run bench` prints it. */
import i18next from "i18next";
import { bench, describe } from "vitest";
import { initI18n } from "~/i18n";
import { ProcessTexts } from "~/live/processTexts";
import { LiveStore } from "~/live/store";
import { process, task } from "~/testing/views";
import { ObjectIndex } from "./objects";
import { rowsFor } from "./search";

const PROCESSES = 2_000;
const TASKS_A_PROCESS = 4;
const TEXTS = new ProcessTexts(new Map());
const TITLES = ["Bin picking", "Prüfung am Eingang", "Palletize boxes", "Change-over of line 3", "Käsikäyttöinen kokoonpano"];
const STEPS = ["Confirm that the part lies free", "Scan the bin", "Pick the part", "Prüfmaß einstellen"];

await initI18n();
await i18next.loadNamespaces("palette");

function topics(): Record<string, unknown> {
  const all: Record<string, unknown> = {};
  for (let nth = 0; nth < PROCESSES; nth += 1) {
    const id = `process-${(nth * 2_654_435_761) % 4_294_967_296}`;
    const tasks = Array.from({ length: TASKS_A_PROCESS }, (_, step) => task({ id: `urn:ngsi-ld:Task:demo:${id}-${step}`, name: STEPS[step] ?? "" }));
    all[`process/${id}`] = process({ id, name: `${TITLES[nth % TITLES.length] ?? ""} · order-${nth}`, tasks });
  }
  return all;
}

const live = new LiveStore();
live.apply({ type: "snapshot", at: "", topics: topics(), events: [] });
const index = new ObjectIndex(live);
index.refresh(TEXTS);
const around = { services: ["task-orchestrator"], showPreferences: () => undefined, showKeys: () => undefined };
const search = (query: string) => rowsFor(query, { pages: [], objects: index.entries, entry: (id) => index.entry(id), recent: [], around });

describe(`${index.entries.length} objects`, () => {
  bench("index all", () => new ObjectIndex(live).refresh(TEXTS));
  bench("index one that has changed", () => {
    live.apply({ type: "batch", at: "", topics: { "process/process-0": process({ id: "process-0", name: `Bin picking ${Math.random()}` }) }, events: [] });
    index.refresh(TEXTS);
  });
  for (const query of ["p", "pick", "pruefung order-1999", "cancel order-7", "cancel", "pikcing 12", "qqqq"]) bench(`search “${query}”`, () => void search(query));
});
