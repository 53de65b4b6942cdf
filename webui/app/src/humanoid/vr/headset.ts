/** The headset: its session, where its space is around the seat, its area, and whether it tracks. */
import { Group, PerspectiveCamera, Quaternion, Vector3, type WebGLRenderer } from "three";
import { SIDES, type Side } from "../humanoid";
import { recentred, type Vector } from "./frames";
import { isFinite3, type TrackedHand } from "./hands";

const PAUSE_BUTTON = 4;
const RECENTRE_BUTTON = 5;
const UP = new Vector3(0, 1, 0);

export interface HeadsetEvents {
  onEnd: () => void;
  /** A trigger or a pinch of a hand. */
  onSelect: (side: Side) => void;
  onPauseButton: () => void;
  /** Another application covers the page: frames may end now. */
  onHidden: () => void;
}

/** Whether the browser has WebXR and a headset. */
export async function hasHeadset(): Promise<boolean> {
  const xr = (navigator as { xr?: XRSystem }).xr;
  return xr !== undefined && (await xr.isSessionSupported("immersive-vr").catch(() => false));
}

export class Headset {
  /** The space of the headset in the scene; recentring moves it. Its child is the camera of the eyes. */
  readonly rig = new Group();
  readonly camera = new PerspectiveCamera(70, 1, 0.05, 40);
  readonly head = new Vector3();
  readonly headTurn = new Quaternion();
  isTracked = false;
  /** Since the last pose that was sent. */
  wasRecentred = false;
  /** The corners of the drawn area in the scene; null where there is none. */
  area: Vector[] | null = null;
  /** Of the right stick, up is positive. */
  stick = 0;
  readonly #session: XRSession;
  readonly #base: XRReferenceSpace;
  readonly #bounded: XRBoundedReferenceSpace | null;
  readonly #knowsGround: boolean;
  readonly #pressed: Record<Side, boolean[]> = { left: [], right: [] };
  readonly #events: HeadsetEvents;
  #isCentred = false;

  private constructor(session: XRSession, base: XRReferenceSpace, bounded: XRBoundedReferenceSpace | null, knowsGround: boolean, events: HeadsetEvents) {
    this.#session = session;
    this.#base = base;
    this.rig.add(this.camera);
    this.#bounded = bounded;
    this.#knowsGround = knowsGround;
    this.#events = events;
    session.addEventListener("end", events.onEnd);
    session.addEventListener("visibilitychange", () => {
      if (session.visibilityState === "visible") return;
      this.isTracked = false;
      events.onHidden();
    });
    session.addEventListener("select", ({ inputSource }) => {
      if (inputSource.handedness !== "none") events.onSelect(inputSource.handedness);
    });
    base.addEventListener("reset", () => this.recentre());
  }

  /** Ask the headset for a session; a press of a button must have led here. */
  static async enter(renderer: WebGLRenderer, events: HeadsetEvents): Promise<Headset> {
    const xr = (navigator as { xr?: XRSystem }).xr;
    if (xr === undefined) throw new Error("this browser has no WebXR");
    const session = await xr.requestSession("immersive-vr", { optionalFeatures: ["local-floor", "bounded-floor", "hand-tracking"] });
    const grounded = await session.requestReferenceSpace("local-floor").catch(() => null);
    const base = grounded ?? (await session.requestReferenceSpace("local"));
    const bounded = (await session.requestReferenceSpace("bounded-floor").catch(() => null)) as XRBoundedReferenceSpace | null;
    renderer.xr.setReferenceSpaceType(grounded === null ? "local" : "local-floor");
    await renderer.xr.setSession(session);
    renderer.xr.setReferenceSpace(base);
    return new Headset(session, base, bounded, grounded !== null, events);
  }

  /** Put the head at the seat with the next pose. */
  recentre(): void {
    this.#isCentred = false;
  }

  /** Read the poses of a frame; a headset that others use, or that lost its place, does not track. */
  read(frame: XRFrame, hands: Readonly<Record<Side, TrackedHand>>): void {
    if (!this.#isCentred) this.#centre(frame);
    const pose = frame.getViewerPose(this.#base);
    this.isTracked = this.#session.visibilityState === "visible" && pose !== undefined && !pose.emulatedPosition && isFinite3(pose.transform.position);
    if (pose !== undefined && this.isTracked) {
      const { position, orientation } = pose.transform;
      this.head.set(position.x, position.y, position.z).applyQuaternion(this.rig.quaternion).add(this.rig.position);
      this.headTurn.set(orientation.x, orientation.y, orientation.z, orientation.w).premultiply(this.rig.quaternion);
    }
    const seen = new Set<Side>();
    for (const source of this.#session.inputSources) {
      const { handedness } = source;
      if (handedness === "none" || !this.isTracked) continue;
      seen.add(handedness);
      hands[handedness].read(frame, source, this.#base, this.rig);
      this.#buttons(handedness, source.gamepad);
    }
    for (const side of SIDES) if (!seen.has(side)) hands[side].lose();
  }

  async leave(): Promise<void> {
    await this.#session.end().catch(() => undefined);
  }

  #centre(frame: XRFrame): void {
    const pose = frame.getViewerPose(this.#base);
    if (pose === undefined) return;
    const origin = recentred(pose.transform.position, pose.transform.orientation, this.#knowsGround);
    if (origin === null) return;
    // the rig undoes the origin; an offset reference space would do the same, but emulators ignore it
    this.rig.quaternion.setFromAxisAngle(UP, -origin.yaw);
    this.rig.position.set(-origin.x, -origin.y, -origin.z).applyQuaternion(this.rig.quaternion);
    this.rig.updateMatrixWorld(true);
    this.#isCentred = this.wasRecentred = true;
    const bounds = this.#bounded === null ? undefined : frame.getPose(this.#bounded, this.#base);
    const corners = this.#bounded?.boundsGeometry ?? [];
    this.area = bounds === undefined || corners.length < 3 ? null : [...corners].map(({ x, y, z }) => inSpace(bounds.transform, x, y, z).applyQuaternion(this.rig.quaternion).add(this.rig.position));
  }

  #buttons(side: Side, gamepad: Gamepad | undefined): void {
    const before = this.#pressed[side];
    const now = [PAUSE_BUTTON, RECENTRE_BUTTON].map((index) => gamepad?.buttons[index]?.pressed === true);
    this.#pressed[side] = now;
    if (now[0] === true && before[0] !== true) this.#events.onPauseButton();
    if (now[1] === true && before[1] !== true) this.recentre();
    if (side === "right") this.stick = -(gamepad?.axes[3] ?? 0);
  }
}

function inSpace({ position, orientation }: XRRigidTransform, x: number, y: number, z: number): Vector3 {
  const turned = new Vector3(x, y, z).applyQuaternion(new Quaternion(orientation.x, orientation.y, orientation.z, orientation.w));
  return turned.set(turned.x + position.x, turned.y + position.y, turned.z + position.z);
}
