/** A hand as SVG, drawn from `geometry.ts`. */
import type { Finger } from "~/live/messages";
import { outline, palm, palmLines, shapeOf, type Bend, type FingerShape, type Phalanx, type Point } from "./geometry";

export interface HandShapeProps {
  bends: readonly Bend[];
  /** Fingers to highlight. */
  differs?: readonly Finger[];
}

export function HandShape({ bends, differs = [] }: HandShapeProps) {
  const shapes = shapeOf(bends);
  const [thumb, ...others] = shapes;
  // Draw all outlines first, then all fills, so that no line appears where parts join.
  const flat = shapes.flatMap((shape) => shape.phalanges.filter(({ folded }) => !folded).map((phalanx) => ({ shape, phalanx })));
  return (
    <>
      <g className="hand__edge">
        <polygon points={places(palm)} />
        {flat.map(({ phalanx }, index) => (
          <Bone key={index} phalanx={phalanx} />
        ))}
      </g>
      <g className="hand__skin">
        <polygon points={places(palm)} />
      </g>
      <g className="hand__crease">
        {palmLines.map((line, index) => (
          <polyline key={index} points={places(line)} />
        ))}
      </g>
      {others.map((shape) => (
        <FingerDrawing key={shape.finger} shape={shape} differs={differs.includes(shape.finger)} />
      ))}
      {thumb !== undefined && <FingerDrawing shape={thumb} differs={differs.includes("thumb")} />}
    </>
  );
}

function FingerDrawing({ shape, differs }: { shape: FingerShape; differs: boolean }) {
  const flat = shape.phalanges.filter(({ folded }) => !folded);
  const folded = shape.phalanges.filter((phalanx) => phalanx.folded);
  return (
    <g className={differs ? "hand__finger hand__finger--differs" : "hand__finger"}>
      {flat.length > 0 && (
        <g className="hand__skin">
          {flat.map((phalanx, index) => (
            <Bone key={index} phalanx={phalanx} />
          ))}
        </g>
      )}
      {folded.length > 0 && (
        <>
          <g className="hand__edge">
            {folded.map((phalanx, index) => (
              <Bone key={index} phalanx={phalanx} />
            ))}
          </g>
          <g className="hand__skin hand__skin--folded">
            {folded.map((phalanx, index) => (
              <Bone key={index} phalanx={phalanx} />
            ))}
          </g>
        </>
      )}
      <g className="hand__crease">
        {shape.creases.map((crease, index) => (
          <polyline key={index} points={places(crease)} />
        ))}
      </g>
      {shape.nail !== null && <polygon className="hand__nail" points={places(shape.nail)} />}
    </g>
  );
}

function Bone({ phalanx }: { phalanx: Phalanx }) {
  return <polygon points={places(outline(phalanx))} />;
}

function places(points: readonly Point[]): string {
  return points.map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" ");
}
