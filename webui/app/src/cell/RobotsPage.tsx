/** The robots of the cell, or one of them: its state, and its control by hand. */
import { lazy } from "react";
import { useTranslation } from "react-i18next";
import { Redirect, useParams } from "wouter";
import { useRobots } from "~/control/robots";
import { Loading } from "~/design/Loading";
import { useRobotNames } from "~/live/names";
import { addresses, ROBOT_TABS } from "~/places/addresses";
import { UnknownName } from "~/route/UnknownName";
import { ListPage } from "./ListPage";
import { ObjectPage } from "./ObjectPage";
import { RobotCard } from "./robots/RobotCard";
import { RobotsPanel } from "./robots/RobotsPanel";

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
  useTranslation(["system", "control"]); // loaded with the page
  const { robots, isLoaded } = useRobots();
  const ofTool = useRobotNames();
  const { tab: asked = "state" } = useParams();
  const tab = ROBOT_TABS.find((other) => other === asked);
  const robot = robots.find((other) => other.name === name);
  if (robot === undefined) return isLoaded ? <UnknownName thing="robot" name={name} list={addresses.robots()} /> : <Loading isPage />;
  if (tab === undefined) return <UnknownName thing="page" name={asked} />;
  return (
    <ObjectPage
      list={{ name: "robots", address: addresses.robots() }}
      name={name}
      names={robots.map((other) => other.name)}
      tab={tab}
      tabs={ROBOT_TABS}
      addressOf={addresses.robot}
    >
      {tab === "control" ? <RobotControl key={name} robot={robot} /> : ofTool.includes(name) ? <RobotCard robot={name} /> : <Redirect to={addresses.device(name)} replace />}
    </ObjectPage>
  );
}
