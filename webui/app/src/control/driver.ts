/** What the person asks for now: all input devices together, the dead-man control, speed and shared control. */
import { SCAN_GAP_MS } from "~/shell/scans";
import type { ControlInput } from "./connection";
import { atRest, DIRECTIONS, GAMEPAD, isUsed, KEYBOARD, ofGamepad, ofKeys, type Direction, type GamepadMapping, type KeyboardMapping, type Motion } from "./mapping";
import { ofTilt, TiltSensor, type Tilt } from "./tilt";

export const MAX_TOOL_MPS = 0.25;
export const MAX_TOOL_RPS = 1;
/** The fraction of the speed of a joint that the service accepts at most. */
const MAX_JOINT_FRACTION = 0.3;
const PRESET_GAIN_PER_S = 1.5;
const PRESET_REACHED = 0.002;

export type DeviceName = "keyboard" | "gamepad" | "screen" | "tilt";

interface JointLimits {
  maxVelocity: number;
}

type Settings = Partial<
  Pick<Driver, "keyboard" | "gamepad" | "screenGamma" | "tiltGamma" | "speed" | "frame" | "mix" | "arbitration" | "joints" | "position">
>;

/** The page changes these values by `set`; `input` reads them 50 times a second. Nothing here renders. */
export class Driver {
  keyboard: KeyboardMapping = KEYBOARD;
  gamepad: GamepadMapping = GAMEPAD;
  screenGamma = 1;
  tiltGamma = 1;
  readonly sensor = new TiltSensor();
  /** The part of the highest speed that is used, up to 1. */
  speed = 0.4;
  frame: "cell" | "tool" = "cell";
  mix = 0;
  arbitration = false;
  joints: readonly JointLimits[] = [];
  position: readonly number[] = [];
  /** The device that was used last: its gamma counts. */
  device: DeviceName = "screen";
  /** The pressed keys (`KeyboardEvent.code`), and since when, in ms of the page. */
  readonly #keys = new Map<string, number>();
  readonly #screen: Motion = atRest();
  #joint: { index: number; sense: number } | null = null;
  #preset: readonly number[] | null = null;
  /** How the phone was tilted when the control was held. */
  #tiltFrom: Tilt | null = null;
  #gripper: "open" | "close" | null = null;
  #wasPressed = false;
  /** After a loss of focus everything must be let go first. */
  #isBlocked = false;
  readonly gamepads: () => readonly (Gamepad | null)[];
  readonly #now: () => number;

  constructor(gamepads: () => readonly (Gamepad | null)[] = () => navigator.getGamepads(), now = () => performance.now()) {
    this.gamepads = gamepads;
    this.#now = now;
  }

  /** Change what the person has set. */
  set(settings: Settings): void {
    Object.assign(this, settings);
  }

  /** Forget all that is pressed: the page lost the focus, is hidden, or the control ended. */
  releaseAll(): void {
    this.#keys.clear();
    Object.assign(this.#screen, atRest());
    this.#joint = null;
    this.#preset = null;
    this.#gripper = null;
    this.#isBlocked = true;
  }

  /** A key counts once it has been held for longer than a scanner holds one, and until it is released. */
  keyDown(code: string, at: number): void {
    if (!this.#keys.has(code)) this.#keys.set(code, at);
  }

  /** Returns whether the key was pressed. */
  keyUp(code: string): boolean {
    return this.#keys.delete(code);
  }

  isPressed(code: string): boolean {
    return this.#keys.has(code);
  }

  hold(isHeld: boolean): void {
    this.#screen.hold = isHeld;
  }

  push(direction: Direction, value: number): void {
    this.#screen.axes[direction] = value;
  }

  pushJoint(index: number, sense: number): void {
    this.#joint = sense === 0 ? null : { index, sense };
  }

  goTo(position: readonly number[] | null): void {
    this.#preset = position;
  }

  grip(act: "open" | "close"): void {
    this.#gripper = act;
  }

  /** What is asked for now. */
  input(): ControlInput {
    const pad = this.gamepads().find((each) => each?.connected === true) ?? null;
    const sources: [DeviceName, Motion][] = [
      ["keyboard", ofKeys(this.#heldKeys(), this.keyboard)],
      ["gamepad", pad === null ? atRest() : ofGamepad(pad, this.gamepad)],
      ["screen", this.#screen],
    ];
    sources.push(["tilt", this.#tilted(sources.some(([, motion]) => motion.hold))]);
    const used = sources.filter(([, motion]) => isUsed(motion));
    if (used.length === 0) this.#isBlocked = false;
    const held = !this.#isBlocked && used.some(([, motion]) => motion.hold);
    this.device = used.find(([, motion]) => DIRECTIONS.some((one) => motion.axes[one] !== 0))?.[0] ?? this.device;
    const gripper = this.#gripperOf(used.map(([, motion]) => motion));
    const common: ControlInput = {
      held,
      gamma: this.#gamma(),
      mix: this.mix,
      arbitration: this.arbitration,
      ...(gripper === null ? {} : { gripper }),
    };
    const joints = this.#jointVelocities();
    if (joints !== null) return { ...common, joints, mix: 0 };
    const axis = (direction: Direction) => limited(used.reduce((sum, [, motion]) => sum + motion.axes[direction], 0)) * this.speed;
    return {
      ...common,
      linear: [axis("x") * MAX_TOOL_MPS, axis("y") * MAX_TOOL_MPS, axis("z") * MAX_TOOL_MPS],
      angular: [axis("rx") * MAX_TOOL_RPS, axis("ry") * MAX_TOOL_RPS, axis("rz") * MAX_TOOL_RPS],
      frame: this.frame,
    };
  }

  #heldKeys(): ReadonlySet<string> {
    const until = this.#now() - SCAN_GAP_MS;
    return new Set([...this.#keys].filter(([, since]) => since <= until).map(([code]) => code));
  }

  /** The tilt moves only while another input holds the control: a phone has no button of its own. */
  #tilted(isHeld: boolean): Motion {
    const tilt = this.sensor.tilt;
    this.#tiltFrom = isHeld && tilt !== null ? (this.#tiltFrom ?? tilt) : null;
    return tilt === null || this.#tiltFrom === null ? atRest() : ofTilt(tilt, this.#tiltFrom);
  }

  #gamma(): number {
    if (this.device === "tilt") return this.tiltGamma;
    if (this.device === "keyboard") return this.keyboard.gamma;
    return this.device === "gamepad" ? this.gamepad.gamma : this.screenGamma;
  }

  /** An act of the gripper begins with the press of its button, once. */
  #gripperOf(motions: readonly Motion[]): "open" | "close" | null {
    const pressed = motions.some((one) => one.open) ? "open" : motions.some((one) => one.close) ? "close" : null;
    const begins = pressed !== null && !this.#wasPressed ? pressed : this.#gripper;
    this.#wasPressed = pressed !== null;
    this.#gripper = null;
    return begins;
  }

  #jointVelocities(): number[] | null {
    const highest = (index: number) => (this.joints[index]?.maxVelocity ?? 0) * MAX_JOINT_FRACTION * this.speed;
    const joint = this.#joint;
    if (joint !== null) return this.joints.map((_, index) => (index === joint.index ? joint.sense * highest(index) : 0));
    const preset = this.#preset;
    if (preset?.length !== this.joints.length || this.position.length !== preset.length) return null;
    const ways = preset.map((target, index) => target - (this.position[index] ?? target));
    const wanted = ways.map((way) => (Math.abs(way) < PRESET_REACHED ? 0 : way * PRESET_GAIN_PER_S));
    // Slowed down together, so that all joints arrive at the same time.
    const excess = Math.max(1, ...wanted.map((speed, index) => Math.abs(speed) / Math.max(highest(index), 1e-6)));
    return wanted.map((speed) => speed / excess);
  }
}

function limited(value: number): number {
  return Math.max(-1, Math.min(1, value));
}
