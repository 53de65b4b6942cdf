/** Cockpit: how processes go, who does the work, and who should get it. */
import { useTranslation } from "react-i18next";
import { SegmentedControl } from "~/design/SegmentedControl";
import { useQueryParameter } from "~/route/queryParameter";
import { useKeys } from "~/shell/keys";
import { AgentsView } from "./agents/AgentsView";
import { MappingView } from "./mapping/MappingView";
import { useScope } from "./query";
import { ScopeBar } from "./ScopeBar";
import { StatisticsView } from "./statistics/StatisticsView";
import "./CockpitPage.css";

const VIEWS = ["statistics", "agents", "mapping"] as const;
const KEYS = { statistics: "s", agents: "a", mapping: "m" } as const;

export default function CockpitPage() {
  const { t } = useTranslation(["cockpit", "common"]);
  const [asked, setView] = useQueryParameter("view", "statistics");
  const view = VIEWS.find((one) => one === asked) ?? "statistics";
  const state = useScope();
  useKeys([
    ...VIEWS.map((value) => ({ key: KEYS[value], does: t("keys.show", { view: t(`view.${value}`) }), act: () => setView(value) })),
    { key: "/", does: t("keys.find"), act: () => document.querySelector<HTMLInputElement>(".process-table input[type=search]")?.focus() },
  ]);
  return (
    <div className="cockpit">
      <header className="cockpit__head">
        <h1>{t("common:pages.cockpit")}</h1>
        <SegmentedControl label={t("view.label")} value={view} options={VIEWS.map((value) => ({ value, name: t(`view.${value}`) }))} onChange={setView} />
        {view === "statistics" && <ScopeBar state={state} />}
      </header>
      {view === "statistics" && <StatisticsView scope={state.scope} onDefinition={state.setDefinition} />}
      {view === "agents" && <AgentsView />}
      {view === "mapping" && <MappingView />}
    </div>
  );
}
