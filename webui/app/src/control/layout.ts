/** What a user has chosen on the page: which panel stands beside the joints, and whether the view is folded. */
export const SIDE_PANELS = ["joints", "presets", "devices", "shared", "recording"] as const;
export type SidePanel = (typeof SIDE_PANELS)[number];

export interface Layout {
  side: SidePanel;
  isViewFolded: boolean;
}

export const STANDARD: Layout = { side: "joints", isViewFolded: false };

export function isLayout(value: unknown): value is Layout {
  if (typeof value !== "object" || value === null) return false;
  const { side, isViewFolded } = value as Record<string, unknown>;
  return (SIDE_PANELS as readonly unknown[]).includes(side) && typeof isViewFolded === "boolean";
}
