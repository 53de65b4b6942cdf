/** An Alert for tests. */
import type { AlertView } from "~/live/messages";

export function alertOf(id: string, rest: Partial<AlertView> = {}): AlertView {
  return {
    id, category: "device", subCategory: null, severity: "high", priority: "high", state: "new", stateAt: null,
    description: `alert ${id}`, source: "urn:ngsi-ld:Device:demo:glove-1", dateIssued: "2026-01-01T08:00:00Z", validTo: null,
    shelvedUntil: null, shelvedBy: null, acknowledged: null, ...rest,
  };
}
