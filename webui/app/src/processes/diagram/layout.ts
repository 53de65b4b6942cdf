/** Layout: a BPMN file without a drawing gets one, so that every file can be looked at. */

/** Whether a BPMN file says where its elements are drawn. */
export function hasDrawing(xml: string): boolean {
  return /<(?:[\w.-]+:)?BPMNShape[\s>]/.test(xml);
}

export interface Drawn {
  xml: string;
  /** The drawing is made here, it does not come from the file. */
  laidOut: boolean;
}

/** The file with a drawing: its own, or one made here. */
export async function drawn(xml: string): Promise<Drawn> {
  if (hasDrawing(xml)) return { xml, laidOut: false };
  const { layoutProcess } = await import("bpmn-auto-layout");
  return { xml: await layoutProcess(xml), laidOut: true };
}
