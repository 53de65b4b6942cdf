import { expect, test } from "vitest";
import { jointsIn, viewOf } from "./urdf";

const URDF = `<robot name="two">
  <joint name="lift" type="prismatic"><limit lower="0.1" upper="0.5" velocity="1"/></joint>
  <joint name="spin" type="continuous"/>
  <joint name="elbow" type="revolute"><limit lower="-3" upper="-1"/></joint>
  <joint name="finger" type="prismatic"><mimic joint="lift"/></joint>
  <joint name="bolt" type="fixed"/>
</robot>`;

test("the moving joints of a URDF are shown within their limits", () => {
  expect(jointsIn(URDF).map(({ name, unit, lower, upper }) => [name, unit, lower, upper])).toEqual([["lift", "m", 0.1, 0.5], ["spin", "rad", null, null], ["elbow", "rad", -3, -1]]);
  expect(viewOf(URDF).home).toEqual([0.3, 0, -2]);
});

test("what is no URDF has no joints", () => {
  expect([jointsIn("no xml"), jointsIn("<other/>")]).toEqual([[], []]);
});
