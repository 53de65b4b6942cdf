/** The line of a small chart: pieces of an SVG path, broken where values are missing. */

export interface SparkPoint {
  t: number;
  mean: number;
}

export interface Spark {
  path: string;
  least: number;
  most: number;
}

/** Draw points of [begin, end] in a box of `width` and `height`; null without points. A gap is longer than `gapS`. */
export function sparkOf(points: readonly SparkPoint[], begin: number, end: number, gapS: number, width: number, height: number): Spark | null {
  const shown = points.filter(({ t }) => t >= begin && t <= end);
  if (shown.length === 0) return null;
  const values = shown.map(({ mean }) => mean);
  const [least, most] = [Math.min(...values), Math.max(...values)];
  const x = (t: number) => round(((t - begin) / (end - begin)) * width);
  const y = (value: number) => round(most === least ? height / 2 : height - ((value - least) / (most - least)) * height);
  let last = -Infinity;
  let path = "";
  for (const { t, mean } of shown) {
    path += `${t - last > gapS ? "M" : "L"}${x(t)} ${y(mean)}`;
    last = t;
  }
  return { path, least, most };
}

function round(value: number): number {
  return Math.round(value * 10) / 10;
}
