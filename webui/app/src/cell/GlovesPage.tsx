/** The gloves of the cell, or one of them: its state, its calibration, a test of what it recognizes, and its history. */
import { lazy } from "react";
import { useTranslation } from "react-i18next";
import { useParams } from "wouter";
import { Loading } from "~/design/Loading";
import { useHasSnapshot } from "~/live/hooks";
import { useGloveNames } from "~/live/names";
import { addresses, GLOVE_TABS } from "~/places/addresses";
import { UnknownName } from "~/route/UnknownName";
import { GloveCard } from "./gloves/GloveCard";
import { GlovesPanel } from "./gloves/GlovesPanel";
import { ListPage } from "./ListPage";
import { ObjectPage } from "./ObjectPage";
import { OpenAlerts } from "./objects/ObjectAlerts";

const Calibration = lazy(() => import("~/calibrate/Calibration"));
const GloveTests = lazy(() => import("./gloves/GloveTests"));
const ObjectHistory = lazy(() => import("./objects/ObjectHistory"));
const GloveTest = lazy(() => import("~/test/GloveTest"));

export default function GlovesPage() {
  // Load `hand` with the page: a panel that loads it later would suspend the page and lose the focus.
  useTranslation(["system", "hand", "calibrate", "test", "cell", "devices", "processes"]);
  const { name } = useParams();
  return name === undefined ? (
    <ListPage name="gloves">
      <GlovesPanel />
    </ListPage>
  ) : (
    <GlovePage name={name} />
  );
}

function GlovePage({ name }: { name: string }) {
  const gloves = useGloveNames();
  const isLoaded = useHasSnapshot();
  const { tab: asked = "state" } = useParams();
  const tab = GLOVE_TABS.find((other) => other === asked);
  if (!gloves.includes(name)) return isLoaded ? <UnknownName thing="glove" name={name} list={addresses.gloves()} /> : <Loading isPage />;
  if (tab === undefined) return <UnknownName thing="page" name={asked} />;
  return (
    <ObjectPage list={{ name: "gloves", address: addresses.gloves() }} name={name} names={gloves} tab={tab} tabs={GLOVE_TABS} addressOf={addresses.glove}>
      {tab === "state" && (
        <>
          <OpenAlerts entity={null} name={name} />
          <GloveCard glove={name} />
        </>
      )}
      {tab === "calibrate" && <Calibration key={name} glove={name} />}
      {tab === "test" && <GloveTest key={name} glove={name} />}
      {tab === "history" && (
        <ObjectHistory entity={null} name={name}>
          <GloveTests glove={name} />
        </ObjectHistory>
      )}
    </ObjectPage>
  );
}
