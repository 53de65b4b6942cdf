/** Angles as people read them. */

/** "-90.0" for an angle in rad; what rounds to nothing has no sign. */
export function degrees(rad: number, language: string): string {
  const rounded = Math.round((rad * 1800) / Math.PI) / 10 + 0;
  return rounded.toLocaleString(language, { minimumFractionDigits: 1, maximumFractionDigits: 1 });
}
