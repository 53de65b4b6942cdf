/** Box plots from 0 to 100: quartiles, median, whiskers, outliers and mean. */
import type { Summary } from "./study";

export interface BoxPlotProps {
  label: string;
  rows: readonly { name: string; parts: readonly { tone: "accent" | "attention"; summary: Summary }[] }[];
  /** A value to compare with, drawn dashed. */
  line?: number;
}

const WIDTH = 800;
const LEFT = 190;
const RIGHT = 20;
const PART = 18;
const GAP = 14;

const at = (value: number): number => LEFT + ((WIDTH - LEFT - RIGHT) * value) / 100;

export function BoxPlot({ label, rows, line }: BoxPlotProps) {
  const heights = rows.map((row) => row.parts.length * (PART + 4) + GAP);
  const topOf = (index: number) => heights.slice(0, index).reduce((sum, height) => sum + height, 6);
  const bottom = topOf(rows.length);
  return (
    <div className="boxes__scroll" role="region" tabIndex={0} aria-label={label}>
      <svg className="boxes" viewBox={`0 0 ${WIDTH} ${bottom + 24}`} role="img" aria-label={label}>
        {Array.from({ length: 11 }, (_, index) => index * 10).map((value) => (
          <g key={value}>
            <line className="boxes__grid" x1={at(value)} x2={at(value)} y1={0} y2={bottom} />
            <text className="boxes__tick" x={at(value)} y={bottom + 17} textAnchor="middle">
              {value}
            </text>
          </g>
        ))}
        {line !== undefined && <line className="boxes__line" x1={at(line)} x2={at(line)} y1={0} y2={bottom} />}
        {rows.map((row, index) => (
          <g key={row.name}>
            <text className="boxes__name" x={LEFT - 12} y={topOf(index) + ((heights[index] ?? 0) - GAP) / 2 + 3} textAnchor="end">
              {row.name}
            </text>
            {row.parts.map(({ tone, summary }, place) => (
              <Box key={tone} tone={tone} summary={summary} y={topOf(index) + place * (PART + 4)} />
            ))}
          </g>
        ))}
      </svg>
    </div>
  );
}

function Box({ tone, summary, y }: { tone: string; summary: Summary; y: number }) {
  const { box, mean } = summary;
  if (box === null) return null;
  const middle = y + PART / 2;
  const whiskers = `M${at(box.low)} ${middle}H${at(box.q1)}M${at(box.q3)} ${middle}H${at(box.high)}`;
  const ends = [box.low, box.high].map((end) => `M${at(end)} ${y + 4}v${PART - 8}`).join("");
  return (
    <g className="boxes__box" data-tone={tone}>
      <path d={whiskers + ends} />
      <rect x={at(box.q1)} y={y} width={Math.max(1, at(box.q3) - at(box.q1))} height={PART} />
      <path className="boxes__median" d={`M${at(box.median)} ${y}v${PART}`} />
      {box.outliers.map((value, index) => (
        <circle key={index} cx={at(value)} cy={middle} r={3} />
      ))}
      {mean !== null && <path className="boxes__mean" d={`M${at(mean) - 5} ${middle}l5 -5l5 5l-5 5z`} />}
    </g>
  );
}
