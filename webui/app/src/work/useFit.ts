/**
* Text as large as it fits, and never smaller than is legible from the station.
 *
* `data-fit` on the page increases from 0 (largest) until nothing overflows; the style sheet defines the
* levels: first the strip and the footer above the minimum, then the size of the text, then optional content, finally scrolling. A
* level is kept for the whole step, so that the size does not change with every message.
 */
import { useCallback, useLayoutEffect, useRef, type RefObject } from "react";

export const MAX_FIT = 7;
/** The part of the screen's height that the hand keeps before strip and footer grow. */
const MIN_HAND = 0.6;
const HIGH = ".work__stage, .work__text, .full-page-state";
/** The stage is not listed: while content slides in, it overflows. */
const WIDE = ".work__text, .full-page-state, .work__strip, .work__footer";

function overflows(page: HTMLElement): boolean {
  const all = (areas: string) => [page, ...page.querySelectorAll<HTMLElement>(areas)];
  return (
    all(HIGH).some(({ scrollHeight, clientHeight }) => scrollHeight > clientHeight + 1) ||
    all(WIDE).some(({ scrollWidth, clientWidth }) => scrollWidth > clientWidth + 1)
  );
}

/** Whether the hand is smaller than it should be for strip and footer to be larger than the minimum. */
function isHandSmall(page: HTMLElement): boolean {
  const hand = page.querySelector(".work__stage > .figure");
  return hand !== null && hand.clientHeight < MIN_HAND * innerHeight;
}

/** `step` identifies the content; a new step or page size starts at level 0. */
export function useFit(page: RefObject<HTMLElement | null>, step: string): void {
  const level = useRef(0);
  const fit = useCallback(() => {
    const element = page.current;
    if (element === null) return;
    for (; ; level.current += 1) {
      element.dataset["fit"] = String(level.current);
      if (level.current >= MAX_FIT || !(overflows(element) || (level.current === 0 && isHandSmall(element)))) return;
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
    const mutations = new MutationObserver(fit);
    mutations.observe(element, { childList: true, characterData: true, subtree: true });
    void document.fonts.ready.then(again);
    return () => {
      sized.disconnect();
      mutations.disconnect();
    };
  }, [page, fit]);
}
