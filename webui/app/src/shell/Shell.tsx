/** The frame of every page: navigation, connection state and preferences. */
import {
  BellRing, Bot, CircleHelp, ClipboardList, Cog, Cpu, Crosshair, Gamepad2, Gauge, HandHelping, HardHat, HeartPulse, House, ListTodo, Settings2, SlidersHorizontal, Thermometer, Users, Workflow,
} from "lucide-react";
import { Suspense, useEffect, useMemo, useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { useLocation } from "wouter";
import { AttentionBanner } from "~/alerts/AttentionBanner";
import { useAlertSound } from "~/alerts/sound";
import { Button } from "~/design/Button";
import { useConnectionState, useTopicSelector } from "~/live/hooks";
import { AccountMenu } from "~/session/AccountMenu";
import { mayDo, useSession } from "~/session/session";
import { KeyList } from "./KeyList";
import { listenForKeys, usePageKeys } from "./keys";
import { Navigation } from "./Navigation";
import { Preferences } from "./Preferences";
import "./Shell.css";

const allPages = [
  { path: "/", name: "start", icon: House, key: "h" },
  { path: "/work", name: "work", icon: HardHat, key: "w" },
  { path: "/processes", name: "processes", icon: Workflow, key: "p" },
  { path: "/cockpit", name: "cockpit", icon: Gauge, key: "k" },
  { path: "/tasks", name: "tasks", icon: ListTodo, key: "t" },
  { path: "/system", name: "system", icon: Cog, key: "s" },
  { path: "/sensors", name: "sensors", icon: Thermometer, key: "m" },
  { path: "/health", name: "health", icon: HeartPulse, key: "b" },
  { path: "/cases", name: "cases", icon: HandHelping, key: "y" },
  { path: "/humanoid", name: "humanoid", icon: Bot, key: "o" },
  { path: "/devices", name: "devices", icon: Cpu, key: "d" },
  { path: "/alerting", name: "alerting", icon: BellRing, key: "a" },
  { path: "/control", name: "control", icon: Gamepad2, key: "c" },
  { path: "/calibrate", name: "calibrate", icon: SlidersHorizontal, key: "l" },
  { path: "/test", name: "test", icon: Crosshair, key: "x" },
  { path: "/people", name: "people", icon: Users, key: "e" },
  { path: "/study", name: "study", icon: ClipboardList, key: "u" },
] as const;

export function Shell({ children }: { children: ReactNode }) {
  const { t } = useTranslation("common");
  const [path, go] = useLocation();
  const [showsKeys, setShowsKeys] = useState(false);
  const [showsPreferences, setShowsPreferences] = useState(false);
  const pageKeys = usePageKeys();
  const pages = useOfferedPages();
  useAlertSound();
  const here = allPages.find((page) => (page.path === "/" ? path === "/" : path.startsWith(page.path)));

  const everywhere = useMemo(
    () => [
      ...pages.map((page) => ({ key: page.key, does: t("keys.goTo", { page: t(`pages.${page.name}`) }), act: () => go(page.path) })),
      { key: "?", does: t("keys.open"), act: () => setShowsKeys(true) },
    ],
    [pages, go, t],
  );
  useEffect(() => listenForKeys([...pageKeys, ...everywhere]), [pageKeys, everywhere]);

  useEffect(() => {
    document.title = here === undefined ? "Handover" : `${t(`pages.${here.name}`)} · Handover`;
  }, [here, t]);

  return (
    <div className="shell">
      <a className="shell__skip" href="#content">
        {t("skip")}
      </a>
      <header className="shell__bar">
        <Navigation pages={pages} here={here?.name} />
        <div className="shell__aside">
          <AccountMenu />
          <Button kind="quiet" label={t("keys.open")} icon={<CircleHelp aria-hidden size={20} />} onPress={() => setShowsKeys(true)} />
          <Button
            kind="quiet"
            label={t("settings")}
            icon={<Settings2 aria-hidden size={20} />}
            onPress={() => setShowsPreferences(true)}
          />
        </div>
      </header>
      <LinkBanner />
      {(here?.name === "start" || here?.name === "work") && <AttentionBanner large={here.name === "work"} />}
      <main id="content" className="shell__content" tabIndex={-1}>
        <Suspense fallback={<p className="shell__loading quiet">{t("loading")}</p>}>{children}</Suspense>
      </main>
      <KeyList
        isOpen={showsKeys}
        onClose={() => setShowsKeys(false)}
        everywhere={everywhere}
        here={pageKeys}
      />
      <Preferences isOpen={showsPreferences} onClose={() => setShowsPreferences(false)} />
    </div>
  );
}

/** The pages of optional services, which are offered while those run. */
const SERVICE_OF: Readonly<Record<string, string>> = { health: "human-state", cases: "assistive-devices", humanoid: "whole-body-control" };

/** Health and Cases are offered to who may read data of others or, for Health, has own. */
function useOfferedPages(): readonly (typeof allPages)[number][] {
  const { user } = useSession();
  const running = useTopicSelector("services", (services) => services?.map(({ name }) => name).join() ?? "");
  const maySee = mayDo("readHealthData");
  const hasOwn = user?.person != null;
  return useMemo(() => {
    const names = running.split(",");
    return allPages.filter(({ name }) => {
      const service = SERVICE_OF[name];
      if (service !== undefined && !names.includes(service)) return false;
      return name === "health" ? maySee || hasOwn : name !== "cases" || maySee;
    });
  }, [running, maySee, hasOwn]);
}

function LinkBanner() {
  const { t } = useTranslation("common");
  const link = useConnectionState();
  const [late, setLate] = useState(false);
  useEffect(() => {
    if (link === "open") return;
    // A short reconnection is not shown, so that the bar does not flicker.
    const timer = setTimeout(() => setLate(true), 1000);
    return () => {
      clearTimeout(timer);
      setLate(false);
    };
  }, [link]);
  if (link === "open" || !late) return null;
  return (
    <p className="shell__link" role="status">
      {t(`link.${link}`)}
    </p>
  );
}
