/** Addresses of former versions, which keep working: links in mails, bookmarks and documents lead to what they named. */
import { addresses, type GloveTab } from "./addresses";

const MOVED: Readonly<Record<string, string>> = {
  "/tasks": addresses.tasks(),
  "/cockpit": addresses.statistics(),
  "/sensors": addresses.sensors(),
  "/cell/sensors": addresses.sensors(),
  "/health": addresses.health(),
  "/cases": addresses.cases(),
  "/humanoid": addresses.humanoid(),
  "/humanoid/vr": addresses.humanoidInVr(),
  "/people": addresses.people(),
  "/study": "/admin/studies",
  "/alerting": "/admin/alerts",
};

const TABS_OF_SYSTEM: Readonly<Record<string, string>> = {
  services: addresses.services(),
  gloves: addresses.gloves(),
  robots: addresses.robots(),
  devices: addresses.cell(),
  ros: "/cell/ros",
  alerts: addresses.alerts(),
  events: addresses.events(),
};

export interface FirstOf {
  robot: string | undefined;
  glove: string | undefined;
}

/**
 * The present address of a former one; null if it is none. `/control`, `/calibrate` and `/test` without a name showed the `first`
 * robot or glove.
 */
export function presentAddress(path: string, search: string, first: FirstOf): string | null {
  const query = new URLSearchParams(search);
  const take = (name: string) => {
    const value = query.get(name) ?? undefined;
    query.delete(name);
    return value === "" ? undefined : value;
  };
  const to = target(path, take, first);
  if (to === null) return null;
  const [present = "", added] = to.split("?");
  for (const [name, value] of new URLSearchParams(added)) query.set(name, value);
  return query.size === 0 ? present : `${present}?${query.toString()}`;
}

function target(path: string, take: (name: string) => string | undefined, first: FirstOf): string | null {
  switch (path) {
    case "/system":
      return TABS_OF_SYSTEM[take("tab") ?? "services"] ?? null;
    case "/control": {
      const robot = take("robot") ?? first.robot;
      return robot === undefined ? addresses.robots() : addresses.robot(robot, "control");
    }
    case "/calibrate":
    case "/test": {
      const glove = take("glove") ?? first.glove;
      return glove === undefined ? addresses.gloves() : addresses.glove(glove, path.slice(1) as GloveTab);
    }
    case "/devices": {
      const device = take("device");
      return device === undefined ? addresses.devices() : addresses.device(device);
    }
    default:
      return MOVED[path] ?? null;
  }
}
