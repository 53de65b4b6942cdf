/** Mappings: which keys, axes and buttons of an input device move what. Each user keeps them, by device. */

/** What an input can move: velocities of the tool, in units of the chosen speed. */
export const DIRECTIONS = ["x", "y", "z", "rx", "ry", "rz"] as const;
export type Direction = (typeof DIRECTIONS)[number];
export const BUTTONS = ["hold", "open", "close"] as const;
export type ButtonUse = (typeof BUTTONS)[number];

/** Velocities from -1 to 1, and what is pressed. */
export interface Motion {
  axes: Record<Direction, number>;
  hold: boolean;
  open: boolean;
  close: boolean;
}

export interface KeyboardMapping {
  gamma: number;
  /** The `KeyboardEvent.code` of each direction and sense, and of each button. */
  keys: Record<`${Direction}${"+" | "-"}` | ButtonUse, string>;
}

/** An axis of a gamepad; `sense` is 1 or -1. Null: not used. */
export interface AxisUse {
  axis: number;
  sense: 1 | -1;
}

export interface GamepadMapping {
  gamma: number;
  deadZone: number;
  axes: Record<Direction, AxisUse | null>;
  buttons: Record<ButtonUse, number>;
}

export const MIN_GAMMA = 0.1;
export const MAX_GAMMA = 2;

export const KEYBOARD: KeyboardMapping = {
  gamma: 1,
  keys: {
    "x+": "KeyW", "x-": "KeyS", "y+": "KeyA", "y-": "KeyD", "z+": "KeyR", "z-": "KeyF",
    "rx+": "KeyI", "rx-": "KeyK", "ry+": "KeyJ", "ry-": "KeyL", "rz+": "KeyQ", "rz-": "KeyE",
    hold: "Space", open: "KeyO", close: "KeyC",
  },
};

/** The standard gamepad: left stick in the plane, right stick up and round, shoulder button to hold. */
export const GAMEPAD: GamepadMapping = {
  gamma: 1,
  deadZone: 0.12,
  axes: {
    x: { axis: 1, sense: -1 },
    y: { axis: 0, sense: -1 },
    z: { axis: 3, sense: -1 },
    rx: null,
    ry: null,
    rz: { axis: 2, sense: -1 },
  },
  buttons: { hold: 5, open: 0, close: 1 },
};

export function atRest(): Motion {
  return { axes: { x: 0, y: 0, z: 0, rx: 0, ry: 0, rz: 0 }, hold: false, open: false, close: false };
}

/** What the pressed keys (`KeyboardEvent.code`) ask for. */
export function ofKeys(pressed: ReadonlySet<string>, { keys }: KeyboardMapping): Motion {
  const motion = atRest();
  for (const direction of DIRECTIONS) {
    motion.axes[direction] = Number(pressed.has(keys[`${direction}+`])) - Number(pressed.has(keys[`${direction}-`]));
  }
  for (const button of BUTTONS) motion[button] = pressed.has(keys[button]);
  return motion;
}

/** What a gamepad asks for: beyond the dead zone an axis grows from 0, so that it never jumps. */
export function ofGamepad(pad: { axes: readonly number[]; buttons: readonly { pressed: boolean }[] }, mapping: GamepadMapping): Motion {
  const motion = atRest();
  for (const direction of DIRECTIONS) {
    const use = mapping.axes[direction];
    const raw = use === null ? 0 : (pad.axes[use.axis] ?? 0) * use.sense;
    const beyond = Math.max(0, Math.abs(raw) - mapping.deadZone) / (1 - mapping.deadZone);
    motion.axes[direction] = beyond === 0 ? 0 : Math.sign(raw) * Math.min(1, beyond);
  }
  for (const button of BUTTONS) motion[button] = pad.buttons[mapping.buttons[button]]?.pressed === true;
  return motion;
}

export function isMoving({ axes }: Motion): boolean {
  return DIRECTIONS.some((direction) => axes[direction] !== 0);
}

export function isUsed(motion: Motion): boolean {
  return isMoving(motion) || motion.hold || motion.open || motion.close;
}

/** Whether a stored value is a mapping of the given form; an old or foreign one is not used. */
export function isLike<T extends object>(value: unknown, standard: T): value is T {
  if (typeof value !== "object" || value === null) return false;
  return Object.entries(standard).every(([name, part]: [string, unknown]) => {
    const found = (value as Record<string, unknown>)[name];
    if (part === null || found === null) return found !== undefined;
    if (typeof part === "object" && "axis" in part) return typeof found === "object";
    if (typeof part === "object") return isLike(found, part);
    return typeof found === typeof part;
  });
}
