import { BoxGeometry, BufferGeometry, Group, Line, LineBasicMaterial, Mesh, MeshBasicMaterial, PerspectiveCamera, Scene, SphereGeometry, Texture, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { ScenePicture } from "./scenePicture";

/** An arm of two links with a line, as a robot with a mark on the ground; `draws` counts pictures. */
function view() {
  const scene = new Scene();
  const camera = new PerspectiveCamera();
  camera.position.set(0, -2, 1);
  const arm = new Group();
  const material = new MeshBasicMaterial({ map: new Texture() });
  const hand = new Mesh(new SphereGeometry(0.05), material);
  hand.position.x = 1;
  arm.add(new Mesh(new BoxGeometry(1, 0.1, 0.1), new MeshBasicMaterial()), hand);
  const mark = new Line(new BufferGeometry().setFromPoints([new Vector3(), new Vector3(0, 0, 1)]), new LineBasicMaterial());
  scene.add(arm, mark);
  const picture = new ScenePicture({ render: () => undefined });
  const draws = () => picture.draw(scene, camera);
  expect(draws()).toBe(true);
  return { scene, camera, arm, hand, mark, material, picture, draws };
}

describe("the picture of a scene", () => {
  it("is not drawn again while nothing moves", () => {
    const { draws, arm } = view();
    expect([draws(), draws()]).toEqual([false, false]);
    arm.rotation.z += 1e-4; // a robot that stands
    expect(draws()).toBe(false);
  });

  it("follows a slow motion, whose steps are each below a pixel", () => {
    const { draws, arm } = view();
    let count = 0;
    for (let step = 0; step < 100; step += 1) {
      arm.rotation.z += 1e-4;
      if (draws()) count += 1;
    }
    expect(count).toBeGreaterThan(10);
    expect(count).toBeLessThan(34);
  });

  it.each<[string, (of: ReturnType<typeof view>) => void]>([
    ["a joint", ({ arm }) => (arm.rotation.z = 0.01)],
    ["what hangs on a joint", ({ hand }) => (hand.position.x = 1.01)],
    ["the camera", ({ camera }) => (camera.position.x = 0.001)],
    ["the shape of the picture", ({ camera }) => {
      camera.aspect = 2;
      camera.updateProjectionMatrix();
    }],
    ["a colour", ({ material }) => material.color.set("#ff0000")],
    ["words on a panel", ({ material }) => {
      if (material.map !== null) material.map.needsUpdate = true;
    }],
    ["a line", ({ mark }) => mark.geometry.setFromPoints([new Vector3(), new Vector3(0.1, 0, 1)])],
    ["a form", ({ hand }) => (hand.geometry = new SphereGeometry(0.06))],
    ["a thing that comes", ({ scene }) => scene.add(new Group())],
    ["a thing that is hidden", ({ hand }) => (hand.visible = false)],
    ["a canvas that was cleared", ({ picture }) => picture.invalidate()],
  ])("is drawn once for %s", (_, change) => {
    const shown = view();
    change(shown);
    expect([shown.draws(), shown.draws()]).toEqual([true, false]);
  });

  it("stays for a line that is made again in the same place, and for what changes while it is hidden", () => {
    const { draws, mark, hand } = view();
    mark.geometry.dispose();
    mark.geometry = new BufferGeometry().setFromPoints([new Vector3(), new Vector3(0, 0, 1)]);
    expect(draws()).toBe(false);
    hand.visible = false;
    draws();
    hand.position.x = 3;
    expect(draws()).toBe(false);
  });
});
