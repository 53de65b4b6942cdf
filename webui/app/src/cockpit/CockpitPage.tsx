/** Cockpit: how processes go, who does the work, and who should get it. */
import { useTranslation } from "react-i18next";
import { SegmentedControl } from "~/design/SegmentedControl";
import { useChoice } from "~/route/choice";
import { useKeys } from "~/shell/keys";
import { AgentsView } from "./agents/AgentsView";
import { CellsView, useCells } from "./cells/CellsView";
import { MappingView } from "./mapping/MappingView";
import { useScope } from "./query";
import { ScopeBar } from "./ScopeBar";
import { StatisticsView } from "./statistics/StatisticsView";
import "./CockpitPage.css";

const VIEWS = ["statistics", "agents", "mapping", "cells"] as const;

export default function CockpitPage() {
  const { t } = useTranslation(["cockpit", "common"]);
  const [view, setView] = useChoice("view", VIEWS, "statistics");
  const state = useScope();
  const hasOthers = (useCells().value?.length ?? 0) > 1;
  const views = VIEWS.filter((each) => each !== "cells" || hasOthers || view === "cells");
  useKeys(
    view === "statistics" ? [{ key: "f", does: t("keys.find"), act: () => document.querySelector<HTMLInputElement>(".process-table input[type=search]")?.focus() }] : [],
  );
  return (
    <div className="cockpit">
      <header className="cockpit__head">
        <h1>{t("common:pages.statistics")}</h1>
        <SegmentedControl label={t("view.label")} value={view} options={views.map((value) => ({ value, name: t(`view.${value}`) }))} onChange={setView} />
        {view === "statistics" && <ScopeBar state={state} />}
      </header>
      {view === "statistics" && <StatisticsView scope={state.scope} onDefinition={state.setDefinition} />}
      {view === "agents" && <AgentsView />}
      {view === "mapping" && <MappingView />}
      {view === "cells" && <CellsView />}
    </div>
  );
}
