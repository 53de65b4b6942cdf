/** What the therapist wants, as the driver of the page Control reads it from all input devices. */
import { MAX_TOOL_MPS, MAX_TOOL_RPS, type Driver } from "~/control/driver";
import type { WishMessage } from "./inputLink";

/** What the service accepts at most, in m/s and rad/s. */
const MOST = { ahead: 0.2, left: 0.1, yaw: 0.3 };

/** The wish of a driver: it is made for a tool, whose full speeds are those of walking here. */
export function wishOf({ held, linear = [], angular = [] }: ReturnType<Driver["input"]>): WishMessage {
  const share = (value: number | undefined, most: number) => (value ?? 0) / most;
  return {
    kind: "wish",
    ahead: MOST.ahead * share(linear[0], MAX_TOOL_MPS),
    left: MOST.left * share(linear[1], MAX_TOOL_MPS),
    yaw: MOST.yaw * share(angular[2], MAX_TOOL_RPS),
    held,
  };
}
