/** A small chart of the last half hour of a value; its text has the range. */
import { sparkOf, type SparkPoint } from "./spark";

export const SPARK_S = 1800;
export const SPARK_POINTS = 60;
const GAP_S = (5 * SPARK_S) / SPARK_POINTS;
const [WIDTH, HEIGHT] = [120, 32];

export function Sparkline({ points, now, isStale }: { points: readonly SparkPoint[]; now: number; isStale: boolean }) {
  const spark = sparkOf(points, now - SPARK_S, now, GAP_S, WIDTH, HEIGHT);
  return (
    <svg className="sparkline" data-stale={isStale || undefined} viewBox={`-2 -2 ${WIDTH + 4} ${HEIGHT + 4}`} aria-hidden preserveAspectRatio="none">
      <line x1="0" x2={WIDTH} y1={HEIGHT + 1} y2={HEIGHT + 1} className="sparkline__base" />
      {spark !== null && <path d={spark.path} vectorEffect="non-scaling-stroke" />}
    </svg>
  );
}
