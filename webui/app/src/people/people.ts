/** The types and requests of people and their gestures. */
import type { DefinedGesture, PersonView as Person, PersonWithGestures } from "~/api/generated/gesture-controller";
import { requestService } from "~/api/http";

export type {
  NeighbourView as Nearest, PersonView as Person, PersonWithGestures as PersonInFull,
} from "~/api/generated/gesture-controller";
export type Gesture = PersonWithGestures["gestures"][number];

/** The definition of a gesture: its code, a recording, or other gestures. */
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

/** Set the gestures of some commands in one request, so that two commands can exchange theirs. */
export function giveCommands(person: string, commands: Record<string, string | null>): Promise<Person> {
  return requestService(SERVICE, `${of(person)}/commands`, { method: "PATCH", json: commands });
}

export function takeCommandBack(person: string, command: string): Promise<Person> {
  return requestService(SERVICE, `${of(person)}/commands/${command}`, { method: "DELETE" });
}

export function define(person: string, gesture: string, how: Recording): Promise<DefinedGesture> {
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

/** The request that gives a command a gesture; a command that has this gesture gets the present one in exchange. */
export function exchanged(person: Person, command: string, gesture: string | null): Record<string, string | null> {
  const other = Object.entries(person.commands).find(([name, value]) => value === gesture && name !== command)?.[0];
  const change = { [command]: gesture };
  return other === undefined ? change : { ...change, [other]: person.commands[command] ?? null };
}

/** The hand shapes that show a gesture. */
export function partsOf(gesture: Gesture): { code: string; side: "left" | "right" }[] {
  if ("code" in gesture) return [{ code: gesture.code, side: "right" }];
  if (gesture.sequence !== undefined) return gesture.sequence.map(({ code }) => ({ code, side: "right" }));
  const { left, right } = gesture;
  return [
    ...(left === undefined ? [] : [{ code: left.code, side: "left" as const }]),
    ...(right === undefined ? [] : [{ code: right.code, side: "right" as const }]),
  ];
}
