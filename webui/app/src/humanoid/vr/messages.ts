/** The pose of the person as it is sent: places on the ground of the robot, and nothing that is no finite number. */
import type { Footprint, Place, Rotation, Side } from "../humanoid";
import type { PoseMessage } from "../inputLink";
import { toGround, turnToGround, type Turn, type Vector } from "./frames";

export interface SentHand {
  isTracked: boolean;
  position: Readonly<Vector>;
  turn: Readonly<Turn>;
  grip: number;
}

export interface SentPose {
  timeS: number;
  anchor: Footprint;
  head: Readonly<Vector>;
  headTurn: Readonly<Turn>;
  isTracked: boolean;
  isInBounds: boolean;
  isRecentred: boolean;
  hands: Readonly<Record<Side, SentHand>>;
}

const place: Vector = { x: 0, y: 0, z: 0 };
const turn: Turn = { x: 0, y: 0, z: 0, w: 1 };

/** A head or a time that is not finite is a lost tracking; a hand that is not finite is not tracked. */
export function poseMessage(sent: SentPose): PoseMessage {
  const headset = posed(sent.anchor, sent.head, sent.headTurn);
  const isTracked = sent.isTracked && headset !== null;
  const hand = ({ isTracked: isSeen, position, turn: turned, grip }: SentHand) => {
    const at = isTracked && isSeen && Number.isFinite(grip) ? posed(sent.anchor, position, turned) : null;
    return at === null ? null : { ...at, grip: Math.min(Math.max(grip, 0), 1) };
  };
  return {
    kind: "pose",
    t: Number.isFinite(sent.timeS) ? sent.timeS : 0,
    headset,
    hands: { left: hand(sent.hands.left), right: hand(sent.hands.right) },
    tracking: isTracked ? "ok" : "lost",
    inBounds: sent.isInBounds,
    recentred: sent.isRecentred,
  };
}

function posed(anchor: Footprint, at: Readonly<Vector>, turned: Readonly<Turn>): { position: Place; rotation: Rotation } | null {
  toGround(anchor, at, place);
  turnToGround(anchor[2], turned, turn);
  const isFinite = Number.isFinite(place.x + place.y + place.z + turn.x + turn.y + turn.z + turn.w);
  return isFinite ? { position: [place.x, place.y, place.z], rotation: [turn.x, turn.y, turn.z, turn.w] } : null;
}
