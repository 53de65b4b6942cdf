/** The confusion matrix: which of its columns say anything. */
import type { Report } from "./tests";

/** The columns in which something stands, and those of what was asked for, in their order. */
export function columnsOf({ asked, recognized, counts }: Report["confusion"]): number[] {
  return recognized.flatMap((name, column) => (asked.includes(name) || counts.some((row) => (row[column] ?? 0) > 0) ? [column] : []));
}
