/** The robot in virtual reality: joints set in place for each frame, without the allocations of the desk view. */
import { Group, type Object3D, type Quaternion, type Vector3 } from "three";
import type { URDFJoint, URDFRobot } from "urdf-loader";
import { parsed, release } from "~/robot3d/urdf";
import { SIDES, type HumanoidModel, type Side } from "../humanoid";
import { BASE, type StateTrack } from "./stateTrack";

interface Hinge {
  joint: URDFJoint;
  rest: Quaternion;
  index: number;
}

export class Body {
  /** In the frame of the ground, z up. */
  readonly root = new Group();
  readonly #robot: URDFRobot;
  readonly #hinges: Hinge[] = [];
  readonly #hands: Partial<Record<Side, { link: Object3D; point: readonly [number, number, number] }>> = {};

  /** Throws `InvalidDescription` for a URDF that cannot be drawn. */
  constructor(urdf: string, model: HumanoidModel) {
    this.#robot = parsed(urdf);
    this.#robot.visible = false; // until its first state
    this.root.add(this.#robot);
    model.joints.forEach((name, index) => {
      const joint = this.#robot.joints[name];
      if (joint !== undefined) this.#hinges.push({ joint, rest: joint.quaternion.clone(), index: BASE + index });
    });
    for (const side of SIDES) {
      const grip = model.hands[`${side}_hand`];
      const link = grip === undefined ? undefined : this.#robot.links[grip.link];
      if (grip !== undefined && link !== undefined) this.#hands[side] = { link, point: grip.point };
    }
  }

  pose({ values }: StateTrack): void {
    const at = (index: number) => values[index] ?? 0;
    this.#robot.visible = true;
    this.#robot.position.set(at(0), at(1), at(2));
    this.#robot.quaternion.set(at(3), at(4), at(5), at(6));
    for (const { joint, rest, index } of this.#hinges) joint.quaternion.setFromAxisAngle(joint.axis, at(index)).premultiply(rest);
  }

  /** Write the place in the scene where a hand of the robot holds things into `out`, after the matrices were updated. */
  hand(side: Side, out: Vector3): boolean {
    const hand = this.#hands[side];
    if (hand === undefined) return false;
    hand.link.localToWorld(out.set(...hand.point));
    return true;
  }

  dispose(): void {
    release(this.root);
  }
}
