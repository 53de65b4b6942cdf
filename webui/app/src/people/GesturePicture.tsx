/** The picture of a gesture: one hand, two, or a sequence. */
import { ArrowRight } from "lucide-react";
import { Fragment } from "react";
import { Hand, useGestureName } from "~/hand/Hand";
import { partsOf, type Gesture } from "./people";

export function GesturePicture({ gesture, size }: { gesture: Gesture; size: string }) {
  const gestureName = useGestureName();
  const inTurn = "sequence" in gesture;
  return (
    <span className="gesture-picture">
      {partsOf(gesture).map(({ code, side }, index) => (
        <Fragment key={index}>
          {inTurn && index > 0 && <ArrowRight aria-hidden size={18} />}
          <Hand states={code} side={side} size={size} label={gestureName(gesture.name)} />
        </Fragment>
      ))}
    </span>
  );
}
