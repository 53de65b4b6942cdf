/** The frame of every page: navigation, connection state and preferences. */
import { Bell, CircleHelp, Settings2 } from "lucide-react";
import { lazy, Suspense, useEffect, useMemo, useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link, useLocation } from "wouter";
import { AttentionBanner, AttentionCount } from "~/alerts/AttentionBanner";
import { useAlertSound } from "~/alerts/sound";
import { Button } from "~/design/Button";
import { Loading } from "~/design/Loading";
import { setGuideState } from "~/home/guideState";
import { useConnectionState, useTopicSelector } from "~/live/hooks";
import { PaletteButton } from "~/palette/PaletteButton";
import { AccountMenu } from "~/session/AccountMenu";
import { addresses } from "~/places/addresses";
import { ALERTS_PAGE, offeredPlaces, pageAt, placeOf, type Place } from "~/places/places";
import { useSession } from "~/session/session";
import { useKiosk } from "./kiosk";
import { KeyList } from "./KeyList";
import { listenForKeys, usePageKeys } from "./keys";
import { PagesOfPlace, Rail } from "./Rail";
import "./Shell.css";

const Preferences = lazy(() => import("./Preferences").then((module) => ({ default: module.Preferences })));

const PRODUCT = "Handover";

export function Shell({ children }: { children: ReactNode }) {
  const { t } = useTranslation("common");
  const [path, go] = useLocation();
  const [showsKeys, setShowsKeys] = useState(false);
  const [showsPreferences, setShowsPreferences] = useState(false);
  const pageKeys = usePageKeys();
  const services = useServices();
  const places = useOfferedPlaces(services);
  useAlertSound();
  const here = pageAt(path);
  const placeName = placeOf(here)?.name;
  const place = places.find(({ name }) => name === placeName);
  const isKiosk = useKiosk() && here?.name === "work";
  const cell = useTopicSelector("cell", (view) => view?.factory);

  const around = useMemo(() => ({ services, showPreferences: () => setShowsPreferences(true), showKeys: () => setShowsKeys(true) }), [services]);
  const everywhere = useMemo(
    () => [
      ...[...places.flatMap(({ pages }) => pages), ALERTS_PAGE].flatMap(({ key, name, path: to }) =>
        key === undefined ? [] : [{ key, does: t("keys.goTo", { page: t(`pages.${name}`) }), act: () => go(to) }],
      ),
      { key: "?", does: t("keys.open"), act: () => setShowsKeys(true) },
    ],
    [places, go, t],
  );
  useEffect(() => listenForKeys(isKiosk ? pageKeys : [...pageKeys, ...everywhere]), [pageKeys, everywhere, isKiosk]);

  useEffect(() => {
    document.title = here === undefined ? "Handover" : `${t(`pages.${here.name}`)} · Handover`;
  }, [here, t]);

  return (
    <div className="shell" data-kiosk={isKiosk || undefined}>
      <a className="shell__skip" href="#content">
        {t("skip")}
      </a>
      {!isKiosk && <Rail places={places} here={place} />}
      <div className="shell__side">
        {!isKiosk && <header className="shell__bar">
          <p className="shell__cell">
            <strong>{PRODUCT}</strong>
            {cell !== undefined && <span className="quiet">{cell}</span>}
          </p>
          {place !== undefined && place.name !== "home" && <PagesOfPlace place={place} here={here} />}
          <div className="shell__aside">
            <PaletteButton places={places} around={around} />
            <Link href={ALERTS_PAGE.path} className="shell__alerts" aria-current={here === ALERTS_PAGE ? "page" : undefined}>
              <Bell aria-hidden size={20} />
              <span className="visually-hidden">{t("pages.alerts")}</span>
              <AttentionCount />
            </Link>
            <AccountMenu />
            <Button kind="quiet" label={t("keys.open")} icon={<CircleHelp aria-hidden size={20} />} onPress={() => setShowsKeys(true)} />
            <Button kind="quiet" label={t("settings")} icon={<Settings2 aria-hidden size={20} />} onPress={() => setShowsPreferences(true)} />
          </div>
        </header>}
        <LinkBanner />
        {(here?.name === "start" || here?.name === "work") && <AttentionBanner large={here.name === "work"} />}
        <main id="content" className="shell__content" tabIndex={-1}>
          <Suspense fallback={<Loading isPage />}>{children}</Suspense>
        </main>
      </div>
      <KeyList
        isOpen={showsKeys}
        onClose={() => setShowsKeys(false)}
        onGuide={() => {
          setGuideState("wanted");
          setShowsKeys(false);
          go(addresses.home());
        }}
        everywhere={everywhere}
        here={pageKeys}
      />
      {showsPreferences && (
        <Suspense fallback={null}>
          <Preferences isOpen onClose={() => setShowsPreferences(false)} />
        </Suspense>
      )}
    </div>
  );
}

/** The names of the services of the cell. */
function useServices(): readonly string[] {
  const running = useTopicSelector("services", (services) => services?.map(({ name }) => name).join() ?? "");
  return useMemo(() => running.split(","), [running]);
}

function useOfferedPlaces(services: readonly string[]): readonly Place[] {
  const { user } = useSession();
  return useMemo(() => offeredPlaces({ services, hasOwnHealth: user?.person != null }), [services, user]);
}

function LinkBanner() {
  const { t } = useTranslation("common");
  const link = useConnectionState();
  const [late, setLate] = useState(false);
  useEffect(() => {
    if (link === "open") return;
    // A short reconnection is not shown, so that the bar does not flicker.
    const timer = setTimeout(() => setLate(true), 500);
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
