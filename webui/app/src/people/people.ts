/** People as the gesture controller answers them, and what can be done for them. */
import { requestService } from "~/api/http";
import type { Finger } from "~/live/messages";

/** A gesture that is one hand shape. */
export interface PlainGesture {
  name: string;
  code: string;
  commandId: number | null;
}

/** A gesture of several: one for each hand, or two in turn. */
export interface Part {
  gesture: string;
  code: string;
}
export interface ComposedGesture {
  name: string;
  commandId: number | null;
  left?: Part;
  right?: Part;
  sequence?: Part[];
}
export type Gesture = PlainGesture | ComposedGesture;

export interface Person {
  name: string;
  title: string | null;
  gloves: { glove: string; hand: "left" | "right"; connected: boolean }[];
  fits: Record<string, { recognizer: string | null; changedAt: string | null }>;
  /** The gesture of each command, as this person gives it. */
  commands: Record<string, string>;
  /** What of that is their own; null: with no gesture at all. */
  ownCommands: Record<string, string | null>;
  ownGestures: Record<string, unknown>;
  /** What of theirs does not go with the site's gestures any more. */
  faults: string[];
}

export interface PersonInFull extends Person {
  gestures: Gesture[];
}

/** The nearest other gesture of one that was defined. */
export interface Nearest {
  gesture: string;
  distance: number;
  fingers: Finger[];
  timesNoise: number | null;
}

/** How a gesture is defined: by its code, by recording it, or by other gestures. */
export type Recording =
  | { code: string }
  | { glove: string; recordMs: number }
  | { left: string; right: string }
  | { sequence: [string, string] };

export const SERVICE = "gesture-controller";

const of = (person: string) => `people/${encodeURIComponent(person)}`;

export function addPerson(person: string, title: string): Promise<Person> {
  return requestService(SERVICE, of(person), { method: "PUT", json: { title } });
}

export function removePerson(person: string): Promise<unknown> {
  return requestService(SERVICE, of(person), { method: "DELETE" });
}

export function wear(glove: string, person: string | null): Promise<unknown> {
  return requestService(SERVICE, `gloves/${encodeURIComponent(glove)}/person`, { method: "PUT", json: { person } });
}

/** Give commands with other gestures; two that exchange theirs are given at once. */
export function giveCommands(person: string, commands: Record<string, string | null>): Promise<Person> {
  return requestService(SERVICE, `${of(person)}/commands`, { method: "PATCH", json: commands });
}

export function takeCommandBack(person: string, command: string): Promise<Person> {
  return requestService(SERVICE, `${of(person)}/commands/${command}`, { method: "DELETE" });
}

export function define(person: string, gesture: string, how: Recording): Promise<{ nearest: Nearest | null }> {
  return requestService(SERVICE, `${of(person)}/gestures/${encodeURIComponent(gesture)}`, { method: "PUT", json: how });
}

export function dropGesture(person: string, gesture: string): Promise<Person> {
  return requestService(SERVICE, `${of(person)}/gestures/${encodeURIComponent(gesture)}`, { method: "DELETE" });
}

export function profileOf(person: string): Promise<string> {
  return requestService(SERVICE, `${of(person)}/profile.yaml`);
}

export function takeProfile(person: string, yaml: string): Promise<Person> {
  return requestService(SERVICE, `${of(person)}/profile.yaml`, { method: "PUT", body: yaml, type: "application/yaml" });
}

/** What a command would be given with: taken from another command, that one gets the gesture of this in turn. */
export function exchanged(person: Person, command: string, gesture: string | null): Record<string, string | null> {
  const other = Object.entries(person.commands).find(([one, its]) => its === gesture && one !== command)?.[0];
  const given = { [command]: gesture };
  return other === undefined ? given : { ...given, [other]: person.commands[command] ?? null };
}

/** The hand shapes that a gesture is shown by. */
export function partsOf(gesture: Gesture): { code: string; side: "left" | "right" }[] {
  if ("code" in gesture) return [{ code: gesture.code, side: "right" }];
  if (gesture.sequence !== undefined) return gesture.sequence.map(({ code }) => ({ code, side: "right" }));
  const { left, right } = gesture;
  return [
    ...(left === undefined ? [] : [{ code: left.code, side: "left" as const }]),
    ...(right === undefined ? [] : [{ code: right.code, side: "right" as const }]),
  ];
}
