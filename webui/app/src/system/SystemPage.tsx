/** The System page: the health of all parts of the cell, and its events. */
import { useTranslation } from "react-i18next";
import { useEffect, useRef, type ReactNode } from "react";
import { Tab, TabList, TabPanel, Tabs } from "react-aria-components";
import { Activity, Bot, Cpu, Hand, ScrollText, TriangleAlert, Waypoints } from "lucide-react";
import { attentionOf } from "~/alerts/attention";
import { useFamily, useTopic } from "~/live/hooks";
import { useChoice } from "~/route/choice";
import { UnknownName } from "~/route/UnknownName";
import { AlertsPanel } from "./alerts/AlertsPanel";
import { DevicesPanel } from "./devices/DevicesPanel";
import { EventsPanel } from "./events/EventsPanel";
import { GlovesPanel } from "./gloves/GlovesPanel";
import { useGloveNames, useRobotNames } from "~/live/names";
import { RobotsPanel } from "./robots/RobotsPanel";
import { RosPanel } from "./ros/RosPanel";
import { ServicesPanel } from "./services/ServicesPanel";
import "./SystemPage.css";

const allTabs = [
  { id: "services", icon: Activity, panel: <ServicesPanel /> },
  { id: "gloves", icon: Hand, panel: <GlovesPanel /> },
  { id: "robots", icon: Bot, panel: <RobotsPanel /> },
  { id: "devices", icon: Cpu, panel: <DevicesPanel /> },
  { id: "ros", icon: Waypoints, panel: <RosPanel /> },
  { id: "alerts", icon: TriangleAlert, panel: <AlertsPanel /> },
  { id: "events", icon: ScrollText, panel: <EventsPanel /> },
] as const;

type TabId = (typeof allTabs)[number]["id"];
const TAB_IDS = allTabs.map(({ id }) => id);

export default function SystemPage() {
  // Load `hand` with the page: a panel that loads it later would suspend the page and lose the focus.
  const { t } = useTranslation(["system", "hand"]);
  const [tab, setTab] = useChoice<TabId>("tab", TAB_IDS, "services");
  const services = useTopic("services");
  const hasRos = services?.some((service) => service.name === "ros-bridge") ?? false;
  const tabs = allTabs.filter(({ id }) => id !== "ros" || hasRos);
  if (tab === "ros" && !hasRos) {
    return services === undefined ? <p className="quiet">{t("common:loading")}</p> : <UnknownName thing="value" name={tab} parameter="tab" />;
  }
  return (
    <div className="system">
      <h1 className="visually-hidden">{t("title")}</h1>
      <Tabs selectedKey={tab} onSelectionChange={(key) => setTab(key as TabId)} className="system__tabs">
        <TabList aria-label={t("title")} className="system__tab-list">
          {tabs.map(({ id, icon: Icon }) => (
            <Tab key={id} id={id} className="system__tab">
              {({ isSelected }) => (
                <ScrolledIntoView isWanted={isSelected}>
                  <Icon aria-hidden size={18} />
                  <span>{t(`tab.${id}`)}</span>
                  <Count tab={id} />
                </ScrolledIntoView>
              )}
            </Tab>
          ))}
        </TabList>
        {tabs.map(({ id, panel }) => (
          <TabPanel key={id} id={id} className="system__panel">
            {panel}
          </TabPanel>
        ))}
      </Tabs>
    </div>
  );
}

/** On a phone the tabs are wider than the screen: scroll the open one into view. */
function ScrolledIntoView({ isWanted, children }: { isWanted: boolean; children: ReactNode }) {
  const face = useRef<HTMLSpanElement>(null);
  useEffect(() => {
    if (isWanted) face.current?.scrollIntoView({ block: "nearest", inline: "center" });
  }, [isWanted]);
  return (
    <span ref={face} className="system__tab-face">
      {children}
    </span>
  );
}

/** The badge of a tab: the number of entries, or of those that need attention. */
function Count({ tab }: { tab: TabId }): ReactNode {
  switch (tab) {
    case "services":
      return <UnwellServices />;
    case "gloves":
      return <Gloves />;
    case "robots":
      return <Robots />;
    case "devices":
      return <Devices />;
    case "alerts":
      return <OpenAlerts />;
    case "ros":
    case "events":
      return null;
  }
}

function Gloves() {
  return <Number of={useGloveNames().length} />;
}

function Robots() {
  return <Number of={useRobotNames().length} />;
}

function Devices() {
  return <Number of={useFamily("device").length} />;
}

function UnwellServices() {
  const { t } = useTranslation("system");
  const unwell = (useTopic("services") ?? []).filter((service) => service.state !== "up");
  if (unwell.length === 0) return null;
  const down = unwell.some((service) => service.state === "down");
  return <Warning tone={down ? "stop" : "attention"} words={t("count.unwell", { count: unwell.length })} of={unwell.length} />;
}

function OpenAlerts() {
  const { t } = useTranslation("system");
  const { count, worst } = attentionOf(useFamily("alert"));
  if (worst === null) return null;
  return <Warning tone={worst.priority === "critical" ? "stop" : "attention"} words={t("count.open", { count })} of={count} />;
}

function Number({ of }: { of: number }) {
  return of === 0 ? null : <span className="system__count">{of}</span>;
}

function Warning({ tone, words, of }: { tone: "attention" | "stop"; words: string; of: number }) {
  return (
    <span className={`system__count system__count--${tone}`}>
      <TriangleAlert aria-hidden size={13} />
      <span aria-hidden>{of}</span>
      <span className="visually-hidden">{words}</span>
    </span>
  );
}
