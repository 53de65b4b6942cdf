/** The icon of each severity: with its word and its colour, never alone. */
import { BadgeInfo, CircleAlert, OctagonAlert, TriangleAlert } from "lucide-react";
import type { Severity } from "~/live/messages";

export const severityIcons: Record<Severity, typeof TriangleAlert> = {
  informational: BadgeInfo,
  low: BadgeInfo,
  medium: CircleAlert,
  high: TriangleAlert,
  critical: OctagonAlert,
};
