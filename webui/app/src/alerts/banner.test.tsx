import { render, screen } from "@testing-library/react";
import { beforeAll, expect, test } from "vitest";
import { setLanguage, initI18n } from "~/i18n";
import { Live } from "~/live/hooks";
import { LiveStore } from "~/live/store";
import type { AlertView } from "~/live/messages";
import { alertOf } from "./alert.fixture";
import { AttentionBanner, AttentionCount } from "./AttentionBanner";

beforeAll(async () => {
  await initI18n();
  await setLanguage("en");
});

function shown(alerts: AlertView[]) {
  const live = new LiveStore();
  live.apply({ type: "snapshot", at: "", topics: Object.fromEntries(alerts.map((alert) => [`alert/${alert.id}`, alert])), events: [] });
  return render(
    <Live value={live}>
      <AttentionBanner large={false} />
      <AttentionCount />
    </Live>,
  );
}

test("the banner names how many and the worst, and is one line for five hundred", () => {
  const many = Array.from({ length: 500 }, (_, index) =>
    alertOf(String(index), index < 100 ? { severity: "critical", priority: "critical", description: `conveyor ${index} is blocked` } : {}),
  );
  shown(many);
  const banner = screen.getByRole("status");
  expect(banner.textContent).toContain("100 critical alerts, 400 high alerts");
  expect(banner.textContent.match(/is blocked/g)).toHaveLength(1);
  expect(screen.getByText("500 new alerts", { exact: false })).toBeDefined();
});

test("nothing urgent, no banner; medium alerts are counted only", () => {
  shown([alertOf("a", { priority: "medium", severity: "medium" }), alertOf("b", { state: "shelved" })]);
  expect(screen.queryByRole("status")).toBeNull();
  expect(screen.getByText("1 new alert", { exact: false })).toBeDefined();
});
