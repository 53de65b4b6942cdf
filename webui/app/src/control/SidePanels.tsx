/** The joints, and one step behind them what is needed less often; the choice is kept for the user. */
import type { ReactNode } from "react";
import { Tab, TabList, TabPanel, Tabs } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { SIDE_PANELS, type SidePanel } from "./layout";

interface SidePanelsProps {
  panels: Partial<Record<SidePanel, ReactNode>>;
  shown: SidePanel;
  /** The choice of the user is not loaded yet. */
  isDisabled: boolean;
  onShow: (panel: SidePanel) => void;
}

export function SidePanels({ panels, shown, isDisabled, onShow }: SidePanelsProps) {
  const { t } = useTranslation("control");
  const offered = SIDE_PANELS.filter((panel) => panels[panel] !== undefined);
  const open = offered.includes(shown) ? shown : "joints";
  return (
    <Tabs className="card control__panel control__panel--side" selectedKey={open} isDisabled={isDisabled} onSelectionChange={(key) => onShow(key as SidePanel)} keyboardActivation="manual">
      <TabList className="side__tabs" aria-label={t("panel.side")}>
        {offered.map((panel) => (
          <Tab key={panel} id={panel} className="side__tab">
            {t(`panel.${panel}`)}
          </Tab>
        ))}
      </TabList>
      <TabPanel id={open} className="side__panel">
        {panels[open]}
      </TabPanel>
    </Tabs>
  );
}
