/** Cockpit: how processes go, who does the work, and who should get it. */
import { useTranslation } from "react-i18next";
import { SegmentedControl } from "~/design/SegmentedControl";
import { useChoice } from "~/route/choice";
import { useKeys } from "~/shell/keys";
import { AgentsView } from "./agents/AgentsView";
import { MappingView } from "./mapping/MappingView";
import { useScope } from "./query";
import { ScopeBar } from "./ScopeBar";
import { StatisticsView } from "./statistics/StatisticsView";
import "./CockpitPage.css";

const VIEWS = ["statistics", "agents", "mapping"] as const;

export default function CockpitPage() {
  const { t } = useTranslation(["cockpit", "common"]);
  const [view, setView] = useChoice("view", VIEWS, "statistics");
  const state = useScope();
  useKeys(
    view === "statistics" ? [{ key: "f", does: t("keys.find"), act: () => document.querySelector<HTMLInputElement>(".process-table input[type=search]")?.focus() }] : [],
  );
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
