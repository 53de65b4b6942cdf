/** The types and requests of the device gateway. */
import type { CertificateView, CommandView, DeviceDescription, DeviceDetails, NewCommand, NewDevice, TokenView } from "~/api/generated/device-gateway";
import { requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { useTopicSelector } from "~/live/hooks";

export const SERVICE = "device-gateway";

export const pathOf = (device: string) => `devices/${encodeURIComponent(device)}`;

export type SymbolOf = (unit: string | null | undefined) => string;

/** The symbols of units by their codes, and a function that writes an unknown code as it is. */
export function useUnits(): { units: Record<string, string>; symbolOf: SymbolOf } {
  const isUp = useTopicSelector("services", (services) => services?.some(({ name, state }) => name === SERVICE && state === "up") ?? false);
  const { value } = useServiceQuery<Record<string, string>>(SERVICE, isUp ? "units" : null);
  const units = value ?? NO_UNITS;
  return { units, symbolOf: (unit) => (unit == null ? "" : (units[unit] ?? unit)) };
}

const NO_UNITS: Record<string, string> = {};

export function addDevice(json: NewDevice): Promise<TokenView> {
  return requestService(SERVICE, "devices", { method: "POST", json });
}

export function describeDevice(device: string, json: DeviceDescription): Promise<DeviceDetails> {
  return requestService(SERVICE, pathOf(device), { method: "PUT", json });
}

export function deleteDevice(device: string): Promise<unknown> {
  return requestService(SERVICE, pathOf(device), { method: "DELETE" });
}

export function newToken(device: string): Promise<TokenView> {
  return requestService(SERVICE, `${pathOf(device)}/token`, { method: "POST" });
}

export function revokeToken(device: string): Promise<unknown> {
  return requestService(SERVICE, `${pathOf(device)}/token`, { method: "DELETE" });
}

export function newCertificate(device: string): Promise<CertificateView> {
  return requestService(SERVICE, `${pathOf(device)}/certificate`, { method: "POST" });
}

export function revokeCertificate(device: string): Promise<unknown> {
  return requestService(SERVICE, `${pathOf(device)}/certificate`, { method: "DELETE" });
}

export function savePicture(device: string, file: File): Promise<unknown> {
  return requestService(SERVICE, `${pathOf(device)}/picture`, { method: "PUT", body: file, type: file.type });
}

/** Store a URDF; with `joints` the joints of the device become those of the URDF. */
export function saveUrdf(device: string, urdf: string, joints: boolean): Promise<DeviceDetails> {
  return requestService(SERVICE, `${pathOf(device)}/urdf?joints=${joints}`, { method: "PUT", body: urdf, type: "application/xml" });
}

export function sendCommand(device: string, json: NewCommand): Promise<CommandView> {
  return requestService(SERVICE, `${pathOf(device)}/commands`, { method: "POST", json });
}

export function cancelCommand(device: string, command: string): Promise<CommandView> {
  return requestService(SERVICE, `${pathOf(device)}/commands/${encodeURIComponent(command)}`, { method: "DELETE" });
}
