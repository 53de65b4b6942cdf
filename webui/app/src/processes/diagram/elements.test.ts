// @vitest-environment jsdom
import { describe, expect, it } from "vitest";
import { processTextsOf } from "~/live/processTexts";
import { elementName, elementsOf, localizedBpmn, pathOf, targetsFor } from "./elements";

const xml = `<?xml version="1.0"?>
<b:definitions xmlns:b="http://www.omg.org/spec/BPMN/20100524/MODEL" id="file">
  <b:process id="main">
    <b:startEvent id="start"/>
    <b:sequenceFlow id="flow" sourceRef="start" targetRef="pick"/>
    <b:serviceTask id="pick" name="Pick
      the part"/>
    <b:boundaryEvent id="late" attachedToRef="pick"/>
    <b:exclusiveGateway id="a.b"/>
    <b:callActivity id="pack" name="Pack" calledElement="packing"/>
    <b:subProcess id="inner"><b:userTask id="look"/><b:endEvent id="done"/></b:subProcess>
    <b:subProcess id="handler" triggeredByEvent="true"><b:task id="mend"/></b:subProcess>
    <b:textAnnotation id="note"/>
  </b:process>
</b:definitions>`;
const elements = elementsOf(xml);
const ids = (element: string) => targetsFor(elements, element).map(({ id }) => id);

describe("the elements of a file", () => {
  it("have the names as one line", () => {
    expect(elements.get("pick")?.name).toBe("Pick the part");
    expect(elementName(elements, "look")).toBe("look");
    expect(elementName(elements, "pack.wrap")).toBe("Pack › wrap");
  });

  it("take a token only within its scope, at flow elements that can hold one", () => {
    expect(ids("pick")).toEqual(["start", "pick", "a.b", "pack", "inner"]);
    expect(ids("look")).toEqual(["look", "done"]);
    expect(ids("unknown")).toEqual([]);
  });

  it("are found by the path of a called process, also where an id has a dot", () => {
    expect(pathOf(elements, "a.b")).toEqual({ drawn: "a.b", inner: null });
    expect(pathOf(elements, "pack.wrap.fold")).toEqual({ drawn: "pack", inner: "wrap.fold" });
    expect(pathOf(elements, "nowhere")).toEqual({ drawn: "nowhere", inner: null });
    expect(elements.get("pack")?.calls).toBe("packing");
  });

  it("are none in a file that is no XML", () => {
    expect(elementsOf("<b:process").size).toBe(0);
  });
});

it("draws a file with the texts of a language", () => {
  const texts = processTextsOf([{ name: "parts", translations: { de: { "Take the part": "Das Teil nehmen", "by hand": "von Hand" } } }], "de");
  const xml = `<d:definitions xmlns:d="http://www.omg.org/spec/BPMN/20100524/MODEL" name="Take the part"><d:task id="a" name="Take
    the part"/><d:textAnnotation id="b"><d:text>by hand</d:text></d:textAnnotation><x name="Take the part" xmlns="urn:x"/></d:definitions>`;
  const localized = localizedBpmn(xml, texts);
  expect(elementName(elementsOf(localized), "a")).toBe("Das Teil nehmen");
  expect(localized).toContain("<d:text>von Hand</d:text>");
  expect(localized).toContain('<x name="Take the part"');
  expect(localizedBpmn("<no xml", texts)).toBe("<no xml");
});
