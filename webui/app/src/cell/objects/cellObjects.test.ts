import { describe, expect, test } from "vitest";
import { alertOf } from "~/alerts/alert.fixture";
import { device, value } from "~/devices/device.fixture";
import type { DeviceView, GloveView, RobotView, ServiceHealth } from "~/live/messages";
import { pageAt } from "~/places/places";
import { task } from "~/testing/views";
import { AlertCounts, isAbout, matches, objectsOf, tasksOf, type CellObject, type Sources } from "./cellObjects";

const URN = "urn:ngsi-ld:Device:demo:";

function entity(name: string, over: Partial<DeviceView> = {}): DeviceView {
  return { id: name.startsWith("urn:") ? name : `${URN}${name}`, category: [], deviceState: "ok", batteryLevel: null, observedAt: null, value: null, ...over };
}

function robot(id: string, over: Partial<RobotView> = {}): RobotView {
  return { id, device: `${URN}${id}`, model: "UR10", deviceState: "idle", operation: null, controlledBy: null, ...over } as RobotView;
}

function glove(name: string, over: Partial<GloveView> = {}): GloveView {
  return { glove: name, connected: true, deviceState: "ok", person: "anna", battery: null, lost: false, ...over } as GloveView;
}

function service(name: string, state: ServiceHealth["state"] = "up"): ServiceHealth {
  return { name, url: null, state, detail: null, since: "2026-01-01T08:00:00Z", rates: {}, lastMessage: null };
}

function listed(over: Partial<Sources>): CellObject[] {
  return objectsOf({ robots: [], gloves: [], registered: [], isRegisteredKnown: true, devices: [], services: [], alerts: new AlertCounts([], new Map()), ...over });
}

const names = (objects: readonly CellObject[]) => objects.map(({ kind, name }) => `${kind} ${name}`);

describe("the objects of the cell", () => {
  test("each is listed once, by kind, whatever number of services know it", () => {
    const objects = listed({
      robots: [robot("arm")],
      gloves: [glove("glove-1")],
      registered: [device({ name: "arm", entity: `${URN}arm`, kind: "robotArm" }), device({ name: "hall-1" }), device({ name: "lamp", entity: `${URN}lamp`, kind: "actuator" })],
      devices: ["arm", "glove-1", "hall-1", "lamp", "press"].map((name) => entity(name, { category: name === "glove-1" ? ["glove"] : [] })),
      services: [service("webui")],
    });
    expect(names(objects)).toEqual(["robot arm", "glove glove-1", "device lamp", "sensor hall-1", "other press", "service webui"]);
    expect(new Set(objects.map(({ key }) => key)).size).toBe(objects.length);
  });

  test("a Device of the broker is called unregistered only after the gateway was asked", () => {
    expect(listed({ devices: [entity("press")], isRegisteredKnown: false })).toEqual([]);
  });

  test("each has an address of its own on a page that exists", () => {
    const devices = [entity("press"), entity("urn:ngsi-ld:Device:plant-2:press"), entity("hall-1")];
    const objects = listed({ robots: [robot("a b")], gloves: [glove("g/1")], registered: [device({ name: "hall-1", entity: `${URN}other` })], devices, services: [service("webui")] });
    expect(new Set(objects.map(({ address }) => address)).size).toBe(objects.length);
    for (const { address } of objects) expect(pageAt(address)?.below).toBeDefined();
  });

  test("what needs attention: a fault, a silent value, a service that is down, a lost glove, an open Alert", () => {
    const attention = (over: Partial<Sources>) => listed(over).map((object) => object.needsAttention);
    expect(attention({ robots: [robot("a"), robot("b", { deviceState: "error" }), robot("c", { deviceState: "busy" })] })).toEqual([false, true, false]);
    expect(attention({ gloves: [glove("a"), glove("b", { connected: false }), glove("c", { connected: false, person: null }), glove("d", { lost: true })] })).toEqual([false, true, false, true]);
    expect(attention({ registered: [device({ values: { temperature: value(20) } }), device({ name: "b", values: { temperature: value(20, true) } })] })).toEqual([false, true]);
    expect(attention({ services: [service("a"), service("b", "degraded"), service("c", "down")] })).toEqual([false, true, true]);
    expect(attention({ robots: [robot("a")], alerts: new AlertCounts([alertOf("1", { source: `${URN}a` })], new Map()) })).toEqual([true]);
  });

  test("an object is found by words of its name and kind", () => {
    const [arm] = listed({ robots: [robot("left-arm")] });
    expect(["ARM left", "robots", ""].map((find) => arm !== undefined && matches(arm, find, "Robots"))).toEqual([true, true, true]);
    expect(arm !== undefined && matches(arm, "glove", "Robots")).toBe(false);
  });
});

describe("Alerts of an object", () => {
  const tasks = tasksOf([{ tasks: [task({ id: "urn:ngsi-ld:Task:demo:t-1", involves: [`${URN}arm`, `${URN}glove-1`] })] }]);

  test("are those about it and about Tasks that involve it, while they are open", () => {
    const counts = new AlertCounts(
      [
        alertOf("1", { source: `${URN}arm` }),
        alertOf("2", { source: "urn:ngsi-ld:Task:demo:t-1", state: "acknowledged" }),
        alertOf("3", { source: `${URN}arm`, state: "shelved" }),
        alertOf("4", { source: `${URN}arm`, state: "returnedToNormal" }),
      ],
      tasks,
    );
    expect([counts.of(`${URN}arm`, "arm"), counts.of(`${URN}glove-1`, "glove-1"), counts.of(null, "glove-1"), counts.of(`${URN}x`, "arm")]).toEqual([2, 1, 1, 0]);
  });

  test("a name is compared only where the entity is not known", () => {
    expect([isAbout(`${URN}arm`, null, "arm"), isAbout(`${URN}arm`, `${URN}arm`, ""), isAbout("urn:ngsi-ld:Device:plant-2:arm", `${URN}arm`, "arm")]).toEqual([true, true, false]);
  });
});

test("ten thousand objects are listed with their Alerts in linear time: each source is read once", () => {
  let reads = 0;
  const registered = Array.from({ length: 10_000 }, (_, number) => {
    const view = device({ name: `s-${number}`, entity: `${URN}s-${number}` });
    return new Proxy(view, { get: (target, member: keyof typeof view) => (member === "name" ? (reads++, target.name) : target[member]) });
  });
  expect(listed({ registered, devices: registered.map((_, number) => entity(`s-${number}`)) })).toHaveLength(10_000);
  expect(reads).toBeLessThan(10 * registered.length);
});
