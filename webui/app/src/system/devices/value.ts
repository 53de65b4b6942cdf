/** The value of any device in a few words: whatever a component wrote there, it fits into a row. */

const MOST = 80;

export function valueInWords(value: unknown): string | null {
  if (value === null || value === undefined) return null;
  const text = typeof value === "string" ? value : JSON.stringify(value);
  return text.length <= MOST ? text : `${text.slice(0, MOST - 1)}…`;
}
