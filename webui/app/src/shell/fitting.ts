/** Which links of a row fit, when the others go into a menu. */

/**
 * Return the indices of the links that fit in `room`, in order: all, or the open one (`here`, -1 for none) and as many of the first as
 * leave room for the button of the menu. Widths are in pixels.
 */
export function fitting(widths: readonly number[], gap: number, menu: number, room: number, here: number): number[] {
  const all = widths.map((_, index) => index);
  const wide = widths.reduce((sum, width) => sum + width + gap, -gap);
  if (wide <= room) return all;
  let left = room - menu;
  const chosen = new Set<number>();
  for (const index of here >= 0 ? [here, ...all.filter((each) => each !== here)] : all) {
    const needed = (widths[index] ?? 0) + gap;
    if (needed > left && index !== here) break;
    left -= needed;
    chosen.add(index);
  }
  return all.filter((index) => chosen.has(index));
}
