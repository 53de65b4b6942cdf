/** Layout: a BPMN file without a drawing gets one, so that every file can be looked at. */

/** Whether a BPMN file has the positions of its elements. */
export function hasDrawing(xml: string): boolean {
  return /<(?:[\w.-]+:)?BPMNShape[\s>]/.test(xml);
}

export interface Drawn {
  xml: string;
  /** The drawing is made here, it does not come from the file. */
  laidOut: boolean;
}

const BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL";

/**
 * The file with `incoming` and `outgoing` on every element that a sequence flow names: both are optional in BPMN,
 * and the layout draws no arrow without them.
 */
export function withFlowsNamed(xml: string): string {
  const document = new DOMParser().parseFromString(xml, "text/xml");
  if (document.querySelector("parsererror") !== null) return xml;
  const byId = new Map([...document.querySelectorAll("[id]")].map((element) => [element.getAttribute("id"), element]));
  const flows = [...document.getElementsByTagNameNS(BPMN, "sequenceFlow")];
  let isChanged = false;
  for (const [end, name] of [["sourceRef", "outgoing"], ["targetRef", "incoming"]] as const) {
    for (const flow of flows) {
      const id = flow.getAttribute("id");
      const element = byId.get(flow.getAttribute(end));
      if (id === null || element === undefined) continue;
      const known = [...element.children].filter((child) => child.namespaceURI === BPMN && child.localName === name);
      if (known.some((child) => child.textContent.trim() === id)) continue;
      const prefix = flow.prefix === null ? "" : `${flow.prefix}:`;
      const reference = document.createElementNS(BPMN, `${prefix}${name}`);
      reference.textContent = id;
      element.append(reference);
      isChanged = true;
    }
  }
  return isChanged ? new XMLSerializer().serializeToString(document) : xml;
}

/** The file with a drawing: its own, or one made here. */
export async function drawn(xml: string): Promise<Drawn> {
  if (hasDrawing(xml)) return { xml, laidOut: false };
  const { layoutProcess } = await import("bpmn-auto-layout");
  return { xml: await layoutProcess(withFlowsNamed(xml)), laidOut: true };
}
