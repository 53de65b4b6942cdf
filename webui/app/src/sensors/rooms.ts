/** The rooms of the site with their devices, in rows of cards. */
import { conditionOf, titleOf } from "~/devices/values";
import type { RegisteredDeviceView } from "~/live/messages";
import { shortName } from "~/live/urn";

/** A line of the page: the heading of a room (null: devices without one), or a row of cards. */
export type RoomLine = { kind: "room"; key: string; room: string | null; count: number } | { kind: "cards"; key: string; devices: RegisteredDeviceView[] };

export function roomOf(device: RegisteredDeviceView): string | null {
  return device.location === null || device.location === "" ? null : shortName(device.location);
}

/** The devices that match every word, or of them those that need attention. */
export function matching(devices: readonly RegisteredDeviceView[], find: string, needsAttention: boolean): RegisteredDeviceView[] {
  const words = find.toLowerCase().split(/\s+/);
  return devices.filter((device) => {
    const text = `${device.name} ${device.title} ${device.kind} ${roomOf(device) ?? ""} ${device.sensors.map((sensor) => sensor.name).join(" ")}`.toLowerCase();
    return words.every((word) => text.includes(word)) && (!needsAttention || conditionOf(device) !== "ok");
  });
}

/** Rooms by name, devices without a room last; in each the devices by their titles. */
export function linesOf(devices: readonly RegisteredDeviceView[], columns: number): RoomLine[] {
  const rooms = new Map<string | null, RegisteredDeviceView[]>();
  for (const device of devices) {
    const room = roomOf(device);
    const members = rooms.get(room);
    if (members === undefined) rooms.set(room, [device]);
    else members.push(device);
  }
  return [...rooms].sort(([a], [b]) => compareRooms(a, b)).flatMap(([room, members]) => {
    members.sort((a, b) => titleOf(a).localeCompare(titleOf(b), undefined, { numeric: true }) || (a.name < b.name ? -1 : 1));
    const rows: RoomLine[] = [{ kind: "room", key: `room ${room ?? ""}`, room, count: members.length }];
    for (let at = 0; at < members.length; at += columns) {
      rows.push({ kind: "cards", key: `cards ${room ?? ""} ${at}`, devices: members.slice(at, at + columns) });
    }
    return rows;
  });
}

function compareRooms(a: string | null, b: string | null): number {
  if (a === null || b === null) return a === b ? 0 : a === null ? 1 : -1;
  return a.localeCompare(b, undefined, { numeric: true });
}
