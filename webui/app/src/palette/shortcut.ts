/** The keys that open the palette: Ctrl K, on Apple's keyboards Command K (where Ctrl K deletes to the end of a line). */

const isApple = /Mac|iPhone|iPad/.test(navigator.userAgent);

/** As a list of keys shows it. */
export const SHORTCUT = isApple ? "⌘ K" : "Ctrl K";

export function isPaletteKey({ key, ctrlKey, metaKey, altKey, shiftKey, repeat }: KeyboardEvent): boolean {
  const hasModifier = isApple ? metaKey && !ctrlKey : ctrlKey && !metaKey;
  return hasModifier && !altKey && !shiftKey && !repeat && key.toLowerCase() === "k";
}
