import { render, screen } from "@testing-library/react";
import i18next from "i18next";
import { beforeAll, describe, expect, it } from "vitest";
import { setLanguage, initI18n } from "~/i18n";
import { Live } from "~/live/hooks";
import { LiveStore } from "~/live/store";
import { glove } from "~/work/scene.fixture";
import { task } from "~/testing/views";
import { TaskState } from "./TaskState";

function show(part: Parameters<typeof task>[0], connected: boolean): string {
  const live = new LiveStore();
  live.apply({ type: "snapshot", at: "", topics: { "glove/glove-1": glove({ connected }) }, events: [] });
  const { container } = render(
    <Live value={live}>
      <TaskState task={task({ involves: ["urn:ngsi-ld:Device:demo:glove-1"], ...part })} />
    </Live>,
  );
  return container.textContent;
}

beforeAll(async () => {
  await initI18n();
  await i18next.loadNamespaces(["processes"]);
  await setLanguage("en");
});

describe("the state of a Task", () => {
  it("is in progress only where somebody is there to perform it", () => {
    expect(show({ status: "inProgress" }, true)).toBe("In progress");
    expect(show({ status: "inProgress" }, false)).toBe("Waiting for glove-1");
    expect(show({ status: "pending" }, false)).toBe("Waiting");
  });

  it("is what a person has answered, whether that fails it or a process handles it", () => {
    expect(show({ status: "failed", outputParameters: { outcome: "notGood" } }, true)).toBe("Not good");
    expect(show({ status: "completed", outputParameters: { outcome: "problem" } }, true)).toBe("Problem");
    expect(show({ status: "completed", outputParameters: { outcome: "ok" } }, true)).toBe("Completed");
    expect(screen.getAllByText("Problem")[0]?.closest(".status-badge--attention")).toBeTruthy();
  });
});
