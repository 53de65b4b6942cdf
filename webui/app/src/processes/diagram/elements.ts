/** The elements of a BPMN file by id: their names, scopes, and where a token can be moved to. */

import type { ProcessTexts } from "~/live/processTexts";

export interface BpmnElement {
  id: string;
  name: string;
  /** The id of the process or subprocess that contains it. */
  scope: string;
  /** The id of the process that a call activity calls; null for other elements. */
  calls: string | null;
  /** A token can be at it. */
  isTarget: boolean;
}

export type BpmnElements = ReadonlyMap<string, BpmnElement>;

export const NO_ELEMENTS: BpmnElements = new Map();

const BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL";
const SUBPROCESSES = ["subProcess", "adHocSubProcess", "transaction"];
const TARGETS = /^(task|\w+Task|callActivity|\w+Gateway|startEvent|endEvent|intermediateCatchEvent|intermediateThrowEvent)$/;

/** Read a BPMN file; one that is no XML has no elements. */
export function elementsOf(xml: string): BpmnElements {
  const document = new DOMParser().parseFromString(xml, "text/xml");
  if (document.querySelector("parsererror") !== null) return NO_ELEMENTS;
  const elements = new Map<string, BpmnElement>();
  for (const node of document.getElementsByTagNameNS(BPMN, "*")) {
    const id = node.getAttribute("id");
    if (id === null) continue;
    const isSubprocess = SUBPROCESSES.includes(node.localName);
    elements.set(id, {
      id,
      name: (node.getAttribute("name") ?? "").replace(/\s+/g, " ").trim(),
      scope: node.parentElement?.getAttribute("id") ?? "",
      calls: node.localName === "callActivity" ? node.getAttribute("calledElement") : null,
      isTarget: TARGETS.test(node.localName) || (isSubprocess && node.getAttribute("triggeredByEvent") !== "true"),
    });
  }
  return elements;
}

/** Return a BPMN file with its drawn texts in the language of the page; one that is no XML stays as it is. */
export function localizedBpmn(xml: string, texts: ProcessTexts): string {
  if (texts.isEmpty) return xml;
  const document = new DOMParser().parseFromString(xml, "text/xml");
  if (document.querySelector("parsererror") !== null) return xml;
  for (const node of document.getElementsByTagNameNS(BPMN, "*")) {
    const name = node.getAttribute("name");
    if (name !== null) node.setAttribute("name", texts.say(name.replace(/\s+/g, " ").trim()));
    else if (node.localName === "text" && node.childElementCount === 0) node.textContent = texts.say(node.textContent.trim());
  }
  return new XMLSerializer().serializeToString(document);
}

/** A place in a process: the element of the drawing, and the path inside of the process that it calls. */
export interface ElementPath {
  drawn: string;
  /** The rest of `call.element`; null for an element of the drawing itself. */
  inner: string | null;
}

/** Resolve an element as the orchestrator names it: `element`, or `call.element` inside of a called process. */
export function pathOf(elements: BpmnElements, element: string): ElementPath {
  for (let end = element.length; end > 0; end = element.lastIndexOf(".", end - 1)) {
    const drawn = element.slice(0, end);
    if (elements.has(drawn)) return { drawn, inner: end === element.length ? null : element.slice(end + 1) };
  }
  return { drawn: element, inner: null };
}

/** The elements that a token at `element` can be moved to: those of the same scope. */
export function targetsFor(elements: BpmnElements, element: string): BpmnElement[] {
  const at = elements.get(element);
  return at === undefined ? [] : [...elements.values()].filter((one) => one.isTarget && one.scope === at.scope);
}

/** What an element is called: its name, or its id where it has none. */
export function elementName(elements: BpmnElements, element: string): string {
  const { drawn, inner } = pathOf(elements, element);
  const named = elements.get(drawn)?.name ?? "";
  const name = named === "" ? drawn : named;
  return inner === null ? name : `${name} › ${inner}`;
}
