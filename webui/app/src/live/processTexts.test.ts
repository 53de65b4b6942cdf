import { expect, it } from "vitest";
import { tasklistIn } from "./hooks";
import type { TasklistView } from "./messages";
import { processTextsOf } from "./processTexts";

const bin = {
  name: "bin-picking",
  translations: {
    de: { "Bin picking": "Griff in die Kiste", "Pick the part": "Das Teil greifen", pick: "greifen", "Look at ${part} in ${bin}": "In ${bin}: ${part} ansehen", "x (mm)": "x in mm" },
    "pt-BR": { "Bin picking": "Separação" },
  },
};
const german = processTextsOf([bin, { name: "other", translations: {} }], "de");

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
    tasks: [{ element: "pick", name: "Pick the part", description: "Look at it in bin-1", inputs: { description: "Pick the part" }, workParameters: { title: "Pick the part" } }],
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

it("prefers the translations of the definition that a document is of", () => {
  const texts = processTextsOf(
    [
      { name: "sale", translations: { de: { Order: "Bestellung", "Look at ${part}": "${part} ansehen" } } },
      { name: "sort", translations: { de: { Order: "Reihenfolge" } } },
    ],
    "de",
  );
  const task = { element: "a", name: "Order", description: "Look at bolt" };
  const process = (definition: string) => ({ definition, version: 1, title: "Order", name: "Order 7", tasks: [{ ...task }] });
  expect(texts.localized(process("sale"))).toMatchObject({ title: "Bestellung", name: "Bestellung 7", tasks: [{ name: "Bestellung" }] });
  expect(texts.localized(process("sort"))).toMatchObject({ title: "Reihenfolge", name: "Reihenfolge 7", tasks: [{ name: "Reihenfolge", description: "bolt ansehen" }] });
  expect(texts.localized([{ name: "sale", title: "Order", translations: {} }])).toMatchObject([{ name: "sale", title: "Bestellung" }]);
  expect(texts.of("sale").say("Order")).toBe("Bestellung");
  const tasks = ["sale-1", "sort-1", "gone-1"].map((process) => ({ process, element: "a", name: "Order" }) as TasklistView);
  const processes = [{ id: "sale-1", definition: "sale" }, { id: "sort-1", definition: "sort" }];
  expect(tasklistIn(texts, tasks, processes).map(({ name }) => name)).toEqual(["Bestellung", "Reihenfolge", "Reihenfolge"]);
  expect(texts.of("called").say("Look at bolt")).toBe("bolt ansehen");
});

it("translates the name of a process by its own title, or by its title expression", () => {
  const texts = processTextsOf([{ name: "bin", translations: { de: { Bin: "Kiste", "Order ${order.number}": "Auftrag ${order.number}", "Bin of ${who}": "Kiste von ${who}" } } }], "de");
  const name = (title: string, name: string) => texts.localized({ definition: "d", version: 1, title, name }).name;
  expect(name("Bin", "Bin 2")).toBe("Kiste 2");
  expect(name("Bin picking", "Bin picking 2")).toBe("Bin picking 2");
  expect(name("Bin", "Bin · order 7")).toBe("Kiste · order 7");
  expect(name("Bin", "Order 7")).toBe("Auftrag 7");
  expect(name("Bin", "Bin of Anna")).toBe("Kiste von Anna");
  expect(name("Bin", "Bin for scrap")).toBe("Bin for scrap");
  const cause = { definition: "d", version: 1, title: "Bin picking", element: "bin", name: "Bin" };
  expect(texts.localized(cause)).toEqual({ ...cause, name: "Kiste" });
});

it("matches a text with placeholders and line breaks, and in linear time", () => {
  const slow = Array.from({ length: 30 }, (_, nth) => `\${${String(nth)}}`).join(" ");
  const texts = processTextsOf([{ name: "d", translations: { de: { "${x}": "Teil ${x}", "${a}: ${b}": "${b}", "Look at ${part} in ${bin}": "In ${bin}: ${part}", [`${slow} end`]: "Schluss" } } }], "de");
  expect(texts.say("Look at bolt\n  in bin-1")).toBe("In bin-1: bolt");
  expect(texts.say("Any: text")).toBe("Any: text");
  expect(texts.say("a ".repeat(1000))).toBe("a ".repeat(1000));
});

it("translates what a schema says of data, whatever the data is named", () => {
  const schema = { properties: { value: { title: "Pick the part" }, title: { title: "Mass" } } };
  expect(german.localized(schema)).toEqual({ properties: { value: { title: "Das Teil greifen" }, title: { title: "Mass" } } });
});

it("takes the language of another region, and a region before its language", () => {
  const definition = { name: "d", translations: { "de-AT": { Bag: "Sackerl" }, de: { Bag: "Tüte", Part: "Teil" } } };
  expect(processTextsOf([definition], "de-AT").say("Bag")).toBe("Sackerl");
  expect(processTextsOf([definition], "de-AT").say("Part")).toBe("Teil");
  expect(processTextsOf([definition], "de").say("Bag")).toBe("Tüte");
  expect(processTextsOf([{ name: "d", translations: { "de-AT": { Bag: "Sackerl" } } }], "de").say("Bag")).toBe("Sackerl");
});

it("keeps the identity of what does not change, and of what it has translated", () => {
  const same = [{ element: "a", name: "Own name" }];
  expect(german.localized(same)).toBe(same);
  const changed = [{ element: "a", name: "Pick the part" }];
  expect(german.localized(changed)).toBe(german.localized(changed));
  expect(processTextsOf([bin], "en").localized(changed)).toBe(changed);
});
