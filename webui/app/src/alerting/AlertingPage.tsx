/** Alerting: rules that find anomalies, routes and channels of Alerts, and the log of what was sent. */
import { useTranslation } from "react-i18next";
import { SegmentedControl } from "~/design/SegmentedControl";
import { useChoice } from "~/route/choice";
import { useQueryChange } from "~/route/queryParameter";
import { MessagesView } from "./MessagesView";
import { ChannelsView, RoutesView } from "./RouteViews";
import { RulesView } from "./RulesView";
import "./AlertingPage.css";

const VIEWS = { rules: RulesView, routes: RoutesView, channels: ChannelsView, sent: MessagesView } as const;
type View = keyof typeof VIEWS;
const NAMES = Object.keys(VIEWS) as View[];

export default function AlertingPage() {
  // Load the texts of all parts with the page: a part that loads them later would suspend it and lose the focus.
  const { t } = useTranslation(["alerting", "common", "tasks", "devices"]);
  const [view] = useChoice("view", NAMES, "rules");
  const change = useQueryChange();
  const Content = VIEWS[view];
  return (
    <div className="alerting-page">
      <header className="alerting-page__head">
        <h1>{t("common:pages.alerting")}</h1>
        <SegmentedControl
          label={t("view.label")}
          value={view}
          options={NAMES.map((name) => ({ value: name, name: t(`view.${name}`) }))}
          onChange={(next) => change({ view: next === "rules" ? "" : next, name: "", add: "", find: "", sort: "" })}
        />
      </header>
      <Content key={view} />
    </div>
  );
}
