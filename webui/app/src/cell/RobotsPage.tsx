/** The robots of the cell, or one of them: its state, control by hand, limits, history and settings. */
import { lazy, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Redirect, useParams } from "wouter";
import { useRobots } from "~/control/robots";
import { EmptyState } from "~/design/EmptyState";
import { Loading } from "~/design/Loading";
import { MayNot } from "~/design/MayNot";
import { useTopicSelector } from "~/live/hooks";
import { useRobotNames } from "~/live/names";
import { addresses, ROBOT_TABS } from "~/places/addresses";
import { UnknownName } from "~/route/UnknownName";
import { mayDo } from "~/session/session";
import { ListPage } from "./ListPage";
import { ObjectPage } from "./ObjectPage";
import { OpenAlerts } from "./objects/ObjectAlerts";
import { RobotCard } from "./robots/RobotCard";
import { RobotsPanel } from "./robots/RobotsPanel";

const ObjectHistory = lazy(() => import("./objects/ObjectHistory"));
const RobotLimits = lazy(() => import("./robots/RobotLimits"));
const RobotSettings = lazy(() => import("./robots/RobotSettings"));
const RobotControl = lazy(() => import("~/control/RobotControl"));

export default function RobotsPage() {
  const { name } = useParams();
  return name === undefined ? (
    <ListPage name="robots">
      <RobotsPanel />
    </ListPage>
  ) : (
    <RobotPage name={name} />
  );
}

function RobotPage({ name }: { name: string }) {
  const { t } = useTranslation(["system", "control", "cell", "processes", "common"]);
  const { robots, isLoaded } = useRobots();
  const ofTool = useRobotNames();
  const { tab: asked = "state" } = useParams();
  const tab = ROBOT_TABS.find((other) => other === asked);
  const robot = robots.find((other) => other.name === name);
  const entity = useTopicSelector(`robot/${name}`, (view) => view?.device ?? null);
  if (robot === undefined) return isLoaded ? <UnknownName thing="robot" name={name} list={addresses.robots()} /> : <Loading isPage />;
  if (tab === undefined) return <UnknownName thing="page" name={asked} />;
  const isOfTool = ofTool.includes(name);
  // A robot of the device gateway has the page of its device, and beside it its control.
  if (!isOfTool && tab !== "control") return <Redirect to={addresses.device(name)} replace />;
  const tabs = ROBOT_TABS.filter((other) => (isOfTool ? other !== "settings" || mayDo("configure") : other === "state" || other === "control"));
  const show = (): ReactNode => {
    switch (tab) {
      case "state":
        return (
          <>
            <OpenAlerts entity={entity} name={name} />
            <RobotCard robot={name} />
          </>
        );
      case "control":
        return mayDo("moveRobots") ? <RobotControl key={name} robot={robot} /> : <EmptyState title={t("control:notAllowed.title")}><MayNot permission="moveRobots" /></EmptyState>;
      case "limits":
        return <RobotLimits key={name} robot={name} />;
      case "history":
        return <ObjectHistory entity={entity} name={name} />;
      case "settings":
        return mayDo("configure") ? <RobotSettings key={name} robot={name} /> : <EmptyState title={t("cell:settings.none")}><MayNot permission="configure" /></EmptyState>;
    }
  };
  return (
    <ObjectPage
      list={{ name: "robots", address: addresses.robots() }}
      name={name}
      names={robots.map((other) => other.name)}
      tab={tab}
      tabs={tabs}
      addressOf={addresses.robot}
    >
      {show()}
    </ObjectPage>
  );
}
