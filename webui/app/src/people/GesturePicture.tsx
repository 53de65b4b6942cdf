/** A gesture as it is made: one hand, two, or one after the other. */
import { ArrowRight } from "lucide-react";
import { Fragment } from "react";
import { Hand, useGestureName } from "~/hand/Hand";
import { partsOf, type Gesture } from "./people";

export function GesturePicture({ gesture, size }: { gesture: Gesture; size: string }) {
  const gestureName = useGestureName();
  const inTurn = "sequence" in gesture;
  return (
    <span className="gesture-picture">
      {partsOf(gesture).map(({ code, side }, nth) => (
        <Fragment key={nth}>
          {inTurn && nth > 0 && <ArrowRight aria-hidden size={18} />}
          <Hand states={code} side={side} size={size} label={gestureName(gesture.name)} />
        </Fragment>
      ))}
    </span>
  );
}
