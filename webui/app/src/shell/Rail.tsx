/** The places: a rail at the side, on a phone a bar at the bottom with the four that the user needs most, and a menu of the others. */
import { Ellipsis } from "lucide-react";
import { useEffect, useRef } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { type Place, type PlacePage } from "~/places/places";
import { mayDo } from "~/session/session";

const BAR_PLACES = 4;

interface RailProps {
  places: readonly Place[];
  here: Place | undefined;
}

export function Rail({ places, here }: RailProps) {
  const { t } = useTranslation("common");
  const first = inBar(places);
  const others = places.filter((place) => !first.includes(place));
  return (
    <nav className="rail" aria-label="Handover">
      {places.map((place) => (
        <PlaceLink key={place.name} place={place} here={here} isInMenu={!first.includes(place)} />
      ))}
      {others.length > 0 && (
        <Menu key={here?.name} label={t("morePlaces")} hasHere={others.some(({ name }) => name === here?.name)}>
          {others.map((place) => (
            <PlaceLink key={place.name} place={place} here={here} />
          ))}
        </Menu>
      )}
    </nav>
  );
}

function PlaceLink({ place, here, isInMenu = false }: { place: Place; here: Place | undefined; isInMenu?: boolean }) {
  const { t } = useTranslation("common");
  const [first] = place.pages;
  if (first === undefined) return null;
  return (
    <Link href={first.path} className="rail__place" data-in-menu={isInMenu || undefined} aria-current={place.name === here?.name ? "true" : undefined}>
      <place.icon aria-hidden size={22} />
      <span>{t(`places.${place.name}`)}</span>
    </Link>
  );
}

/** The pages of the open place, beside each other. */
export function PagesOfPlace({ place, here }: { place: Place; here: PlacePage | undefined }) {
  const { t } = useTranslation("common");
  const row = useRef<HTMLElement>(null);
  useEffect(() => {
    row.current?.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest", inline: "center" });
  }, [here]);
  return (
    <nav className="shell__pages" aria-label={t(`places.${place.name}`)} ref={row}>
      {place.pages.map((page) => (
        <Link key={page.path} href={page.path} className="shell__page" aria-current={page.name === here?.name ? "page" : undefined}>
          {t(`pages.${page.name}`)}
        </Link>
      ))}
    </nav>
  );
}

/** The places of the bar of a phone, by what the user may do, in the order of the rail. */
function inBar(places: readonly Place[]): readonly Place[] {
  const order: readonly Place["name"][] = mayDo("configure")
    ? ["home", "cell", "processes", "work", "admin", "care"]
    : mayDo("performTasks")
      ? ["home", "work", "processes", "cell", "care", "admin"]
      : mayDo("readHealthData")
        ? ["home", "care", "work", "admin", "processes", "cell"]
        : ["home", "admin", "cell", "processes", "work", "care"];
  const wanted = places.map(({ name }) => name).sort((name, other) => order.indexOf(name) - order.indexOf(other)).slice(0, BAR_PLACES);
  return places.filter(({ name }) => wanted.includes(name));
}

/** A menu of links; it closes with Escape, with a press elsewhere, and when a place opens. */
function Menu({ label, hasHere, children }: { label: string; hasHere: boolean; children: React.ReactNode }) {
  const menu = useRef<HTMLDetailsElement>(null);
  useEffect(() => {
    const close = (event: Event) => {
      const details = menu.current;
      if (details?.open !== true) return;
      if (event instanceof KeyboardEvent ? event.key !== "Escape" : details.contains(event.target as Node)) return;
      details.open = false;
      if (event instanceof KeyboardEvent) details.querySelector("summary")?.focus();
    };
    document.addEventListener("pointerdown", close);
    document.addEventListener("keydown", close);
    return () => {
      document.removeEventListener("pointerdown", close);
      document.removeEventListener("keydown", close);
    };
  }, []);
  return (
    <details className="rail__more" ref={menu}>
      <summary className="rail__place" aria-current={hasHere ? "true" : undefined}>
        <Ellipsis aria-hidden size={22} />
        <span>{label}</span>
      </summary>
      <div className="rail__menu">{children}</div>
    </details>
  );
}
