/** A registered device for tests, in the format of the device gateway. */
import type { DeviceValue, RegisteredDeviceView } from "~/live/messages";

export function value(of: number, stale = false): DeviceValue {
  return { value: of, t: 1_767_225_600, unit: null, stale };
}

export function device(over: Partial<RegisteredDeviceView> = {}): RegisteredDeviceView {
  return {
    name: "hall-1",
    entity: "urn:ngsi-ld:Device:demo:hall-1",
    kind: "sensor",
    title: "",
    connected: true,
    hasToken: true,
    state: null,
    batteryLevel: null,
    seenAt: null,
    updatedAt: 1_767_225_600,
    location: null,
    sensors: [
      { name: "temperature", unit: "CEL", minimum: -20, maximum: 60 },
      { name: "humidity", unit: "P1", minimum: 0, maximum: 100 },
    ],
    values: {},
    ...over,
  };
}
