/** The hands of the person in the scene: tracked hands, controllers, or a pointer at a depth. */
import { BoxGeometry, Group, InstancedMesh, Matrix4, Mesh, MeshBasicMaterial, MeshStandardMaterial, Quaternion, SphereGeometry, TorusGeometry, Vector3 } from "three";
import type { Side } from "../humanoid";

const JOINTS = 25;
const JOINT_M = 0.009;
/** Of a pinch: thumb and index finger so near are closed, so far are open. */
const PINCH_M = { closed: 0.02, open: 0.08 };
const COLOURS = { open: "#f0c9a8", closed: "#4d8bef", reach: "#3fbf7f" };
const SQUEEZE = 1;
const TRIGGER = 0;

/** Where the space of the headset is in the scene. */
export interface Rig {
  position: Vector3;
  quaternion: Quaternion;
}

export class TrackedHand {
  readonly side: Side;
  readonly root = new Group();
  /** Of the palm, in the scene. */
  readonly position = new Vector3();
  readonly turn = new Quaternion();
  /** Along -z is where it points. */
  readonly rayFrom = new Vector3();
  readonly rayTurn = new Quaternion();
  grip = 0;
  isTracked = false;
  hasRay = false;
  source: XRInputSource | null = null;
  readonly #palm = new Mesh(new SphereGeometry(0.035, 20, 14), new MeshStandardMaterial({ color: COLOURS.open, roughness: 0.8 }));
  readonly #handle = new Mesh(new BoxGeometry(0.035, 0.035, 0.12), new MeshStandardMaterial({ color: "#3a4452", roughness: 0.6 }));
  readonly #reach: Mesh<TorusGeometry, MeshBasicMaterial>;
  readonly #joints = new InstancedMesh(new SphereGeometry(JOINT_M, 10, 8), new MeshStandardMaterial({ color: COLOURS.open, roughness: 0.8 }), JOINTS);
  readonly #matrix = new Matrix4();
  readonly #joint = new Vector3();
  #isClosed = false;

  constructor(side: Side, reachM: number) {
    this.side = side;
    this.#reach = new Mesh(new TorusGeometry(reachM, 0.002, 6, 48), new MeshBasicMaterial({ color: COLOURS.reach, transparent: true, opacity: 0.6 }));
    this.root.add(this.#palm, this.#handle, this.#reach, this.#joints);
    this.#joints.frustumCulled = false;
    this.#palm.castShadow = true;
    this.root.visible = false;
    this.#palm.matrixAutoUpdate = this.#handle.matrixAutoUpdate = this.#reach.matrixAutoUpdate = true;
  }

  /** The ring that shows the reach of the palm, which is that of the service. */
  setReach(radiusM: number): void {
    if (Math.abs(this.#reach.geometry.parameters.radius - radiusM) < 1e-6) return;
    this.#reach.geometry.dispose();
    this.#reach.geometry = new TorusGeometry(radiusM, 0.002, 6, 48);
  }

  lose(): void {
    this.isTracked = this.hasRay = false;
    this.source = null;
    this.root.visible = false;
  }

  /** Take the pose of an input source for this frame. */
  read(frame: XRFrame, source: XRInputSource, space: XRReferenceSpace, rig: Rig): void {
    this.source = source;
    const palm = source.hand === undefined ? source.gripSpace : (source.hand.get("middle-finger-metacarpal") ?? source.gripSpace);
    const pose = palm === undefined ? undefined : frame.getPose(palm, space);
    this.isTracked = pose !== undefined && isFinite3(pose.transform.position);
    if (pose === undefined || !this.isTracked) {
      this.lose();
      return;
    }
    const { position, orientation } = pose.transform;
    this.position.set(position.x, position.y, position.z).applyQuaternion(rig.quaternion).add(rig.position);
    this.turn.set(orientation.x, orientation.y, orientation.z, orientation.w).premultiply(rig.quaternion);
    this.grip = source.hand !== undefined ? this.#pinch(frame, source.hand, space, rig) : squeeze(source.gamepad);
    const ray = frame.getPose(source.targetRaySpace, space);
    this.hasRay = ray !== undefined && isFinite3(ray.transform.position);
    if (ray !== undefined) {
      const { position: from, orientation: towards } = ray.transform;
      this.rayFrom.set(from.x, from.y, from.z).applyQuaternion(rig.quaternion).add(rig.position);
      this.rayTurn.set(towards.x, towards.y, towards.z, towards.w).premultiply(rig.quaternion);
    }
    this.#handle.visible = source.hand === undefined;
    this.#draw();
  }

  /** Put the hand at a place of the scene, for a pointer without a headset. */
  put(place: Vector3, turn: Quaternion, grip: number): void {
    this.isTracked = isFinite3(place);
    this.source = null;
    this.hasRay = false;
    this.grip = grip;
    this.position.copy(place);
    this.turn.copy(turn);
    this.#handle.visible = this.#joints.visible = false;
    this.#draw();
  }

  /** A pulse on the controller; hands without one feel nothing. */
  pulse(intensity: number, ms: number): void {
    // WebXR has a list of actuators with pulses, which the types of gamepads do not know
    const gamepad = this.source?.gamepad as { hapticActuators?: { pulse?: (value: number, ms: number) => Promise<unknown> }[] } | undefined;
    void gamepad?.hapticActuators?.[0]?.pulse?.(intensity, ms).catch(() => undefined);
  }

  dispose(): void {
    for (const part of [this.#palm, this.#handle, this.#reach, this.#joints]) {
      part.geometry.dispose();
      part.material.dispose();
    }
    this.#joints.dispose();
    this.root.removeFromParent();
  }

  #draw(): void {
    this.root.visible = this.isTracked;
    this.#palm.position.copy(this.position);
    this.#handle.position.copy(this.position);
    this.#handle.quaternion.copy(this.turn);
    this.#reach.position.copy(this.position);
    this.#reach.quaternion.copy(this.turn);
    const isClosed = this.grip >= 0.5;
    if (isClosed === this.#isClosed) return;
    this.#isClosed = isClosed;
    this.#palm.material.color.set(isClosed ? COLOURS.closed : COLOURS.open);
  }

  /** Draw the joints of a hand, and return how far it is closed. */
  #pinch(frame: XRFrame, hand: XRHand, space: XRReferenceSpace, rig: Rig): number {
    let index = 0;
    this.#joints.visible = true;
    for (const joint of hand.values()) {
      const pose = frame.getJointPose?.(joint, space);
      if (pose === undefined || index >= JOINTS) continue;
      const { x, y, z } = pose.transform.position;
      this.#joint.set(x, y, z).applyQuaternion(rig.quaternion).add(rig.position);
      this.#joints.setMatrixAt(index, this.#matrix.makeTranslation(this.#joint));
      index += 1;
    }
    this.#joints.count = index;
    this.#joints.instanceMatrix.needsUpdate = true;
    const thumb = hand.get("thumb-tip");
    const finger = hand.get("index-finger-tip");
    const from = thumb === undefined ? undefined : frame.getJointPose?.(thumb, space)?.transform.position;
    const to = finger === undefined ? undefined : frame.getJointPose?.(finger, space)?.transform.position;
    if (from === undefined || to === undefined) return 0;
    const apart = Math.hypot(from.x - to.x, from.y - to.y, from.z - to.z);
    return Math.min(Math.max((PINCH_M.open - apart) / (PINCH_M.open - PINCH_M.closed), 0), 1);
  }
}

function squeeze(gamepad: Gamepad | undefined): number {
  const value = Math.max(gamepad?.buttons.at(SQUEEZE)?.value ?? 0, gamepad?.buttons.at(TRIGGER)?.value ?? 0);
  return Number.isFinite(value) ? Math.min(Math.max(value, 0), 1) : 0;
}

export function isFinite3({ x, y, z }: Readonly<{ x: number; y: number; z: number }>): boolean {
  return Number.isFinite(x + y + z);
}
