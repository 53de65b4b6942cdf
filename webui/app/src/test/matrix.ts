/** The columns of the confusion matrix that are worth showing. */
import type { Report } from "./tests";

/** The columns with counts and those of the requested gestures, in their order. */
export function columnsOf({ asked, recognized, counts }: Report["confusion"]): number[] {
  return recognized.flatMap((name, column) => (asked.includes(name) || counts.some((row) => (row[column] ?? 0) > 0) ? [column] : []));
}
