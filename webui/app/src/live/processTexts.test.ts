import { expect, it } from "vitest";
import { processTextsOf } from "./processTexts";

const bin = {
  title: "Bin picking",
  translations: {
    de: { "Bin picking": "Griff in die Kiste", "Pick the part": "Das Teil greifen", pick: "greifen", "Look at ${part} in ${bin}": "In ${bin}: ${part} ansehen", "x (mm)": "x in mm" },
    "pt-BR": { "Bin picking": "Separação" },
  },
};
const german = processTextsOf([bin, { title: "Other", translations: {} }], "de");

it("says what has a translation, also for a region, and leaves the rest", () => {
  expect(german.say("Pick the part")).toBe("Das Teil greifen");
  expect(german.say(" Pick  the\npart ")).toBe("Das Teil greifen");
  expect(german.say("Another text")).toBe("Another text");
  expect(processTextsOf([bin], "de-AT").say("Pick the part")).toBe("Das Teil greifen");
  expect(processTextsOf([bin], "pt-BR").say("Bin picking")).toBe("Separação");
  expect(processTextsOf([bin], "en").say("Pick the part")).toBe("Pick the part");
  expect(processTextsOf([bin], "constructor").say("Pick the part")).toBe("Pick the part");
});

it("puts what stands for a placeholder where the translation has it", () => {
  expect(german.say("Look at bolt $1 in bin-1")).toBe("In bin-1: bolt $1 ansehen");
});

it("translates what people read of a document, and no ids and no data", () => {
  const process = {
    id: "pick",
    name: "Bin picking 12",
    title: "Bin picking",
    definition: "bin-picking",
    variables: { title: "Pick the part" },
    parameters: [{ name: "pick", default: "Pick the part" }],
    tasks: [{ element: "pick", name: "Pick the part", description: "Look at it in bin-1", inputs: { description: "Pick the part" } }],
    form: { fields: [{ path: ["x"], label: "x (mm)", hint: null, initial: "Pick the part", options: [{ value: "Pick the part", label: "Pick the part" }] }] },
  };
  expect(german.localized(process)).toEqual({
    ...process,
    name: "Griff in die Kiste 12",
    title: "Griff in die Kiste",
    tasks: [{ ...process.tasks[0], name: "Das Teil greifen", description: "In bin-1: it ansehen" }],
    form: { fields: [{ ...process.form.fields[0], label: "x in mm", options: [{ value: "Pick the part", label: "Das Teil greifen" }] }] },
  });
  expect(german.localized({ name: "pick", version: 1, title: "Own title" })).toEqual({ name: "pick", version: 1, title: "Own title" });
  expect(german.localized({ processName: "Bin picking · order 7", processTitle: "Bin picking" })).toEqual({ processName: "Griff in die Kiste · order 7", processTitle: "Griff in die Kiste" });
});

it("keeps the identity of what does not change, and of what it has translated", () => {
  const same = [{ element: "a", name: "Own name" }];
  expect(german.localized(same)).toBe(same);
  const changed = [{ element: "a", name: "Pick the part" }];
  expect(german.localized(changed)).toBe(german.localized(changed));
  expect(processTextsOf([bin], "en").localized(changed)).toBe(changed);
});
