/** "glove-1" of `urn:ngsi-ld:Device:demo:glove-1`; what is no URN stays as it is. */
export function shortName(urn: string): string {
  return urn.startsWith("urn:") ? urn.slice(urn.lastIndexOf(":") + 1) : urn;
}
