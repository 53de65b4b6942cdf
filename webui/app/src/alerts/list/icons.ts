/** The icon of each severity, always shown with its word and colour. */
import { BadgeInfo, CircleAlert, OctagonAlert, TriangleAlert } from "lucide-react";
import type { Severity } from "~/live/messages";

export const severityIcons: Record<Severity, typeof TriangleAlert> = {
  informational: BadgeInfo,
  low: BadgeInfo,
  medium: CircleAlert,
  high: TriangleAlert,
  critical: OctagonAlert,
};
