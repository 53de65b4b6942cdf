/** The description of a device as a form: its fields, and the way there and back. */
import type { DeviceDescription, DeviceKind } from "~/api/generated/device-gateway";
import type { FormField } from "~/api/generated/task-orchestrator";
import { field } from "~/tasks/field";
import { draftOf, entered, type Draft, type Entered } from "~/tasks/form";

export const KINDS: readonly DeviceKind[] = ["robotArm", "mobileRobot", "humanoid", "gripper", "sensor", "actuator", "wearable", "inputDevice", "camera", "edge", "other"];
const WITH_JOINTS: readonly DeviceKind[] = ["robotArm", "mobileRobot", "humanoid", "gripper"];
const GRIPPERS = ["parallel", "vacuum", "magnetic", "hand", "other"] as const;
const JOINTS = ["revolute", "continuous", "prismatic"] as const;
const COMMANDS = ["motion", "action", "setting"] as const;
const AXES = ["x", "y", "z"] as const;

type Translate = (key: string) => string;

/** Whether a device of this kind has joints and perhaps a gripper. */
export function hasJoints(kind: unknown): boolean {
  return WITH_JOINTS.includes(kind as DeviceKind);
}

/** The fields of a device of `kind`; `t` translates the namespace "devices". */
export function fieldsOf(t: Translate, units: Readonly<Record<string, string>>, kind: unknown): FormField[] {
  const label = (path: string) => t(`form.${path}`);
  const text = (path: string, name = path, over: Partial<FormField> = {}) => field({ path, kind: "text", label: label(name), ...over });
  const number = (path: string, unit: string | null = null, name = path) => field({ path, kind: "number", label: label(name), unit });
  const choice = (path: string, name: string, values: readonly string[], over: Partial<FormField> = {}) =>
    field({ path, kind: "choice", label: label(name), options: values.map((value) => ({ value, label: t(`${name}.${value}`) })), ...over });
  const unitOptions = Object.entries(units).map(([value, symbol]) => ({ value, label: symbol === "" ? value : `${symbol} (${value})` }));
  const general = [
    choice("kind", "kind", KINDS, { isRequired: true }),
    text("title"),
    field({ path: "description", kind: "multiline", label: label("description") }),
    text("manufacturer"),
    text("model"),
    text("serialNumber"),
  ];
  const place = [
    text("placement.location", "location", { hint: t("form.locationHint") }),
    ...AXES.map((axis) => field({ path: `placement.${axis}`, kind: "number", label: axis, unit: "m" })),
    number("placement.longitude", "°", "longitude"),
    number("placement.latitude", "°", "latitude"),
    ...(kind === "edge" ? [] : [text("edge", "edge", { hint: t("form.edgeHint") })]),
  ];
  const sensor = [
    text("name", "valueName", { isRequired: true }),
    field({ path: "unit", kind: "choice", label: label("unit"), options: unitOptions }),
    number("minimum"),
    number("maximum"),
    number("deadBand"),
  ];
  const joint = [
    text("name", "jointName", { isRequired: true }),
    choice("type", "jointType", JOINTS, { isRequired: true, initial: "revolute" }),
    number("lower"),
    number("upper"),
    number("maxVelocity"),
    number("maxEffort"),
  ];
  const command = [
    text("name", "commandName", { isRequired: true }),
    choice("kind", "commandKind", COMMANDS, { isRequired: true, initial: "action" }),
    text("description"),
    field({ path: "parameters", kind: "json", label: label("parameters"), hint: t("form.parametersHint") }),
  ];
  const group = (path: string, fields: FormField[]) => field({ path, kind: "group", label: label(path), fields });
  const list = (path: string, fields: FormField[]) => field({ path, kind: "list", label: label(path), fields });
  const robot = [
    group("robot", [field({ path: "degreesOfFreedom", kind: "integer", label: label("degreesOfFreedom"), minimum: 1 }), text("skills", "skills", { hint: t("form.skillsHint") })]),
    list("joints", joint),
    group("gripper", [choice("gripper.type", "gripperType", GRIPPERS), number("gripper.maxWidth", "m", "maxWidth"), number("gripper.maxForce", "N", "maxForce")]),
  ];
  return [group("general", general), group("place", place), list("sensors", sensor), ...(hasJoints(kind) ? robot : []), list("commands", command)];
}

/** The entries that show a description. */
export function draftOfDescription(fields: readonly FormField[], description: DeviceDescription): Draft {
  const { placement = {}, skills = [], ...rest } = description;
  const [longitude, latitude] = placement.coordinates ?? [];
  const [x, y, z] = placement.relativePosition ?? [];
  return draftOf(fields, { ...rest, skills: skills.join(", "), placement: { location: placement.location, x, y, z, longitude, latitude } });
}

/** The description that was entered; what the form does not show is kept from `before`. */
export function enteredDescription(fields: readonly FormField[], draft: Draft, before: DeviceDescription | null): { description: DeviceDescription; faults: Entered["faults"] } {
  const { values, faults } = entered(fields, draft);
  const { placement = {}, skills = "", gripper, ...rest } = values as { placement?: Record<string, unknown>; skills?: string; gripper?: Record<string, unknown> };
  const { location, longitude, latitude } = placement;
  if ((longitude === undefined) !== (latitude === undefined)) faults[longitude === undefined ? "placement.longitude" : "placement.latitude"] ??= { code: "required" };
  if (gripper !== undefined && gripper["type"] === undefined) faults["gripper.type"] ??= { code: "required" };
  const hasPosition = AXES.some((axis) => placement[axis] !== undefined);
  const words = skills.split(",").map((skill) => skill.trim()).filter((skill) => skill !== "");
  const kept = (before?.joints ?? []).map((joint) => [joint.name, joint.maxAcceleration] as const);
  const joints = (rest as { joints?: NonNullable<DeviceDescription["joints"]> }).joints?.map((joint) => {
    const maxAcceleration = kept.find(([name]) => name === joint.name)?.[1];
    return maxAcceleration == null ? joint : { ...joint, maxAcceleration };
  });
  const description = {
    ...rest,
    ...(joints === undefined ? {} : { joints }),
    ...(gripper === undefined ? {} : { gripper }),
    ...(words.length === 0 ? {} : { skills: words }),
    placement: {
      ...(location === undefined ? {} : { location }),
      ...(hasPosition ? { relativePosition: AXES.map((axis) => placement[axis] ?? 0) } : {}),
      ...(longitude === undefined ? {} : { coordinates: [longitude, latitude] }),
    },
  } as unknown as DeviceDescription;
  return { description, faults };
}
