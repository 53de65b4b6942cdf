/**
 * Type as large as the stage has room for, and never below what can be read from the station.
 *
 * `data-fit` on the page counts up from 0 (generous) until nothing overflows; the style sheet says what each
 * level gives up: size above the minimum first, then what helps but is not needed, and at last it scrolls. A
 * level is kept while the same step is shown, so that nothing grows and shrinks with every word.
 */
import { useCallback, useLayoutEffect, useRef, type RefObject } from "react";

export const MAX_FIT = 6;
const HIGH = ".work__stage, .work__text, .full-page-state";
/** The stage is not among these: what slides in is a little beside its place. */
const WIDE = ".work__text, .full-page-state, .work__strip, .work__footer";

function overflows(page: HTMLElement): boolean {
  const all = (areas: string) => [page, ...page.querySelectorAll<HTMLElement>(areas)];
  return (
    all(HIGH).some(({ scrollHeight, clientHeight }) => scrollHeight > clientHeight + 1) ||
    all(WIDE).some(({ scrollWidth, clientWidth }) => scrollWidth > clientWidth + 1)
  );
}

/** `step`: what is shown; another one begins generously again, and so does another size of the page. */
export function useFit(page: RefObject<HTMLElement | null>, step: string): void {
  const level = useRef(0);
  const fit = useCallback(() => {
    const element = page.current;
    if (element === null) return;
    for (; ; level.current += 1) {
      element.dataset["fit"] = String(level.current);
      if (level.current >= MAX_FIT || !overflows(element)) return;
    }
  }, [page]);
  useLayoutEffect(() => {
    level.current = 0;
    fit();
  }, [step, fit]);
  useLayoutEffect(() => {
    const element = page.current;
    if (element === null || typeof ResizeObserver === "undefined") return;
    const again = () => {
      level.current = 0;
      fit();
    };
    const sized = new ResizeObserver(again);
    sized.observe(element);
    const said = new MutationObserver(fit);
    said.observe(element, { childList: true, characterData: true, subtree: true });
    void document.fonts.ready.then(again);
    return () => {
      sized.disconnect();
      said.disconnect();
    };
  }, [page, fit]);
}
