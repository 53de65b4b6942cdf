import i18next from "i18next";
import { beforeAll, describe, expect, it } from "vitest";
import { inWords, eventText, localizedText } from "~/i18n/server";

beforeAll(async () => {
  await i18next.init({
    lng: "de",
    resources: {
      de: {
        server: {
          arm: { away: "Der Arm {{robot}} antwortet seit {{seconds}} s nicht." },
          task: { failed: "Fehlgeschlagen: {{reason}}" },
        },
      },
    },
    interpolation: { escapeValue: false },
  });
});

describe("what a server says", () => {
  it("is said in the language of the page, numbers and parts too", () => {
    const part = { text: "away", textCode: "arm.away", textParameters: { robot: "ur10-1", seconds: 1234.5 } };
    const task = { reason: "failed: away", reasonCode: "task.failed", reasonParameters: { reason: part } };
    expect(localizedText(task, "reason")).toBe("Fehlgeschlagen: Der Arm ur10-1 antwortet seit 1.234,5 s nicht.");
  });

  it("stays English where the page has no words for it", () => {
    expect(localizedText({ detail: "new", detailCode: "brand.new", detailParameters: {} }, "detail")).toBe("new");
    expect(localizedText({ detail: "plain" }, "detail")).toBe("plain");
    expect(inWords({ text: "plain", code: null, parameters: {} })).toBe("plain");
  });

  it("is nothing where there is no text", () => {
    expect(eventText({}, "detail")).toBeNull();
    expect(eventText({ detail: 7 }, "detail")).toBeNull();
  });
});
