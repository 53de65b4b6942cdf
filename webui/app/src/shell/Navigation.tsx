/** The navigation: the pages that fit, the open one among them, and a menu of the others. */
import { Ellipsis } from "lucide-react";
import { useEffect, useLayoutEffect, useRef, useState, type ComponentType, type RefObject } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { AttentionCount } from "~/alerts/AttentionBanner";
import { fitting } from "./fitting";

export interface NavigationPage {
  path: string;
  name: string;
  icon: ComponentType<{ size?: number; "aria-hidden"?: boolean }>;
}

export function Navigation({ pages, here }: { pages: readonly NavigationPage[]; here: string | undefined }) {
  const { t } = useTranslation("common");
  const row = useRef<HTMLDivElement>(null);
  const current = pages.findIndex((page) => page.name === here);
  const shown = useShown(row, pages.length, current);
  const others = pages.filter((_, index) => !shown.has(index));
  return (
    <nav className="shell__nav" aria-label="Handover">
      <div className="shell__row" ref={row}>
        {pages.map((page, index) => (
          <Link
            key={page.path}
            href={page.path}
            className={shown.has(index) ? "shell__page" : "shell__page shell__page--away"}
            aria-current={index === current ? "page" : undefined}
          >
            <page.icon aria-hidden size={20} />
            <span>{t(`pages.${page.name}`)}</span>
            {page.name === "system" && <AttentionCount />}
          </Link>
        ))}
      </div>
      {others.length > 0 && <MorePages key={here} pages={others} />}
    </nav>
  );
}

/** A menu of links; it closes with Escape, with a press elsewhere, and when a page opens. */
function MorePages({ pages }: { pages: readonly NavigationPage[] }) {
  const { t } = useTranslation("common");
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
    <details className="shell__more" ref={menu}>
      <summary className="shell__page" aria-label={t("morePages")} title={t("morePages")}>
        <Ellipsis aria-hidden size={20} />
      </summary>
      <div className="shell__menu">
        {pages.map((page) => (
          <Link key={page.path} href={page.path} className="shell__page">
            <page.icon aria-hidden size={20} />
            <span>{t(`pages.${page.name}`)}</span>
          </Link>
        ))}
      </div>
    </details>
  );
}

const MENU_PX = 44;

/** Return the indices of the pages that fit, also when the window, the words or the count of Alerts change. */
function useShown(row: RefObject<HTMLElement | null>, count: number, current: number): ReadonlySet<number> {
  const [shown, setShown] = useState<readonly number[]>(() => Array.from({ length: count }, (_, index) => index));
  useLayoutEffect(() => {
    const bar = row.current;
    if (bar?.parentElement == null) return;
    const nav = bar.parentElement;
    const links = [...bar.querySelectorAll<HTMLElement>(":scope > a")];
    const measure = () => {
      const gap = Number.parseFloat(getComputedStyle(bar).columnGap) || 0;
      const next = fitting(links.map((link) => link.offsetWidth), gap, MENU_PX, nav.clientWidth, current);
      setShown((before) => (before.join() === next.join() ? before : next));
    };
    measure();
    const observer = new ResizeObserver(measure);
    for (const element of [nav, ...links]) observer.observe(element);
    return () => observer.disconnect();
  }, [row, count, current]);
  return new Set(shown);
}
