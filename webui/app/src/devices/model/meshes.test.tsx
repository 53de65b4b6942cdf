import { expect, test } from "vitest";
import { linksWithMeshes } from "./meshes";

test("links that are drawn without their mesh files are named", () => {
  const shape = (inner: string) => `<visual><geometry>${inner}</geometry></visual>`;
  const urdf = `<robot name="arm"><link name="base">${shape('<mesh filename="package://arm/base.dae"/>')}</link><link name="tip">${shape('<sphere radius="0.1"/>')}</link></robot>`;
  expect(linksWithMeshes(urdf)).toEqual(["base"]);
  expect(linksWithMeshes("no XML")).toEqual([]);
});
