/** The panels of the page, which each user arranges. */
export const PANELS = ["view", "jog", "joints", "shared", "presets", "devices", "latency"] as const;
export type PanelId = (typeof PANELS)[number];

export interface Arrangement {
  order: PanelId[];
  hidden: PanelId[];
}

export const STANDARD: Arrangement = { order: [...PANELS], hidden: [] };

export function isArrangement(value: unknown): value is Arrangement {
  if (typeof value !== "object" || value === null) return false;
  const { order, hidden } = value as Record<string, unknown>;
  return [order, hidden].every((list) => Array.isArray(list) && list.every((one) => (PANELS as readonly unknown[]).includes(one)));
}

/** All panels in the order of the user; one that is new comes last. */
export function ordered({ order }: Arrangement): PanelId[] {
  return [...new Set([...order, ...PANELS])];
}

/** The arrangement with `panel` moved by one place among the shown ones. */
export function moved(arrangement: Arrangement, panel: PanelId, by: 1 | -1): Arrangement {
  const order = ordered(arrangement);
  const shown = order.filter((one) => !arrangement.hidden.includes(one));
  const other = shown[shown.indexOf(panel) + by];
  if (other === undefined) return arrangement;
  const swapped = order.map((one) => (one === panel ? other : one === other ? panel : one));
  return { ...arrangement, order: swapped };
}

export function withShown(arrangement: Arrangement, panel: PanelId, isShown: boolean): Arrangement {
  const hidden = arrangement.hidden.filter((one) => one !== panel);
  return { order: ordered(arrangement), hidden: isShown ? hidden : [...hidden, panel] };
}
