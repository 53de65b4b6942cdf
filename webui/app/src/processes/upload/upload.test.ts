import { describe, expect, it } from "vitest";
import { ApiError } from "~/api/http";
import { faultsOf, listedFaults } from "./faults";
import { textOf } from "./file";

const refusal = (more: object) => new ApiError({ title: "BPMN cannot be deployed", detail: "line 3: no", status: 422, ...more });

describe("the faults of a file", () => {
  it("come as the orchestrator lists them", () => {
    const faults = [{ element: "scan", name: "Scan the bin", line: 67, message: "nobody does it" }, { element: null, name: null, line: null, message: "no start" }];
    expect(faultsOf(refusal({ faults }))).toEqual(faults);
  });

  it("are at least one, whatever the answer looks like", () => {
    const whole = [{ element: null, name: null, line: null, message: "line 3: no" }];
    expect(faultsOf(refusal({}))).toEqual(whole);
    expect(faultsOf(refusal({ faults: "many" }))).toEqual(whole);
    expect(faultsOf(refusal({ faults: [{ line: 3 }, 7, null] }))).toEqual(whole);
  });
});

describe("warnings of a file", () => {
  it("are listed as faults are, with the name of the element in the drawing", () => {
    expect(listedFaults([{ element: "store", name: "", line: 4, message: "no effect" }])).toEqual([{ element: "store", name: null, line: 4, message: "no effect" }]);
    expect(listedFaults(undefined)).toEqual([]);
  });
});

describe("the text of a file", () => {
  const bytes = (head: string, ...tail: number[]) => new Blob([new Uint8Array([...new TextEncoder().encode(head), ...tail])]);

  it("is UTF-8 unless it says otherwise", async () => {
    expect(await textOf(bytes('<?xml version="1.0"?><a>', 0xc3, 0xa4))).toContain("ä");
    expect(await textOf(bytes('<?xml version="1.0" encoding="ISO-8859-1"?><a>', 0xe4))).toContain("ä");
  });

  it("is read even when its encoding is unknown", async () => {
    expect(await textOf(bytes('<?xml version="1.0" encoding="klingon"?><a/>'))).toContain("<a/>");
  });

  it("is detected as UTF-16 by its byte order mark", async () => {
    const text = new Blob([new Uint8Array([0xff, 0xfe, 0x3c, 0, 0x61, 0, 0x2f, 0, 0x3e, 0])]);
    expect(await textOf(text)).toBe("<a/>");
  });
});
