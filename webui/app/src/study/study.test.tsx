import { fireEvent, render, screen } from "@testing-library/react";
import i18next from "i18next";
import { beforeAll, describe, expect, it, vi } from "vitest";
import { setLanguage, initI18n } from "~/i18n";
import { BoxPlot } from "./BoxPlot";
import { SusForm } from "./SusForm";
import { TlxForm } from "./TlxForm";
import type { Session, Wording } from "./study";

const scales = ["mental", "physical", "effort"];
const scale = (title: string) => ({ title, ask: `How much ${title}?`, low: "Low", high: "High" });
const words = {
  sus: { title: "How was the system?", ask: "", disagree: "Disagree", agree: "Agree", items: ["I like it.", "It is complex."] },
  tlx: { title: "How was the task?", ask: "", choose: "Which of the two?", scales: Object.fromEntries(scales.map((name) => [name, scale(name)])) },
  scales,
  scaleStep: 5,
} as unknown as Wording;
const pairs = [["mental", "physical"], ["effort", "mental"], ["physical", "effort"]];
const session = { id: "s1", language: "en", step: "tlx1", pairs } as unknown as Session;

beforeAll(async () => {
  await initI18n();
  await i18next.loadNamespaces(["study"]);
  await setLanguage("en");
});

describe("the questionnaires", () => {
  it("take SUS only when every statement is answered", () => {
    const answer = vi.fn();
    const { container } = render(<SusForm words={words} session={session} busy={false} answer={answer} />);
    const mark = (statement: number, place: number) => {
      const input = container.querySelectorAll(`input[value="${place}"]`)[statement];
      if (input !== undefined) fireEvent.click(input);
    };
    const next = () => screen.getByText("Next");
    mark(0, 5);
    fireEvent.click(next());
    expect(answer).not.toHaveBeenCalled();
    expect(container.querySelector("[role=status]")?.textContent).toBe("1 unanswered");
    mark(1, 1);
    fireEvent.click(next());
    expect(answer).toHaveBeenCalledWith({ answers: [5, 1] });
  });

  it("take NASA-TLX only when every scale is marked, and one of each pair is chosen", () => {
    const answer = vi.fn();
    const { container } = render(<TlxForm words={words} session={session} busy={false} answer={answer} />);
    const sliders = [...container.querySelectorAll("input[type=range]")];
    expect(sliders.map((slider) => slider.getAttribute("aria-valuetext"))).toEqual(Array(3).fill("not rated yet"));
    sliders.forEach((slider, index) => fireEvent.change(slider, { target: { value: String(10 * (index + 1)) } }));
    fireEvent.click(screen.getByText("Next"));
    fireEvent.click(screen.getByText("mental"));
    fireEvent.click(screen.getByText("Back"));
    for (const chosen of ["physical", "mental", "effort"]) fireEvent.click(screen.getByText(chosen));
    expect(answer).toHaveBeenCalledWith({
      ratings: { mental: 10, physical: 20, effort: 30 },
      choices: pairs.map((of, index) => ({ of, chosen: ["physical", "mental", "effort"][index] })),
    });
  });

  it("count a scale that is left in the middle on purpose as marked", () => {
    const { container } = render(<TlxForm words={words} session={session} busy={false} answer={vi.fn()} />);
    const [first] = container.querySelectorAll("input[type=range]");
    if (first !== undefined) fireEvent.pointerUp(first);
    expect(first?.getAttribute("aria-valuetext")).toBe("50, Low – High");
  });
});

it("draws a box, its outliers and the line to compare with", () => {
  const box = { min: 10, q1: 40, median: 50, q3: 60, max: 90, low: 30, high: 70, outliers: [10, 90] };
  const { container } = render(<BoxPlot label="SUS" line={68} rows={[{ name: "SUS", parts: [{ tone: "accent", summary: { n: 9, mean: 50, sd: 1, box } }] }]} />);
  expect(container.querySelectorAll("circle")).toHaveLength(2);
  expect(container.querySelectorAll(".boxes__line")).toHaveLength(1);
  const [rect] = container.querySelectorAll("rect");
  expect(Number(rect?.getAttribute("width"))).toBeCloseTo((800 - 190 - 20) * 0.2);
});
