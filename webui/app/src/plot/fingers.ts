/** The five fingers, thumb first, and how their lines are told apart without colour. */
import type { Finger } from "~/live/messages";

export const fingers: readonly Finger[] = ["thumb", "index", "middle", "ring", "little"];
export const dashes = [[], [10, 4], [3, 3], [10, 3, 3, 3], [16, 5]];
