import { describe, expect, it } from "vitest";
import { languageOf, minutesText, newWords, trainerOf, type Intervention } from "./trainer";

const said = (number: number, text?: string): Intervention => ({ number, at: `2026-05-04T08:0${number}:00Z`, advice: "keep", source: "template", ...(text === undefined ? {} : { text }) });

describe("the trainer", () => {
  it("is there for the machine that has one", () => {
    expect(trainerOf({ details: {} })).toBeNull();
    expect(trainerOf({ details: { trainer: { timeLeftS: 3 } } })?.timeLeftS).toBe(3);
  });

  it("speaks what is new since the page came, once it has words", () => {
    const interventions = [said(1, "one"), said(2, "two")];
    expect(newWords(interventions, null)).toBeNull();
    expect(newWords(interventions, said(2).at)).toBeNull();
    expect(newWords([...interventions, said(3)], said(2).at)).toBeNull();
    expect(newWords([...interventions, said(3, "three")], said(2).at)?.text).toBe("three");
    expect(newWords([], "")).toBeNull();
  });

  it("shows the time left in minutes and seconds", () => {
    expect([600, 65, 59.2, 0, -3].map(minutesText)).toEqual(["10:00", "1:05", "1:00", "0:00", "0:00"]);
  });

  it("speaks a template in the language of the page and a model in that of the training", () => {
    expect(languageOf({ source: "template" }, { language: "fi" }, "de")).toBe("de");
    expect(languageOf({ source: "model" }, { language: "fi" }, "de")).toBe("fi");
  });
});
