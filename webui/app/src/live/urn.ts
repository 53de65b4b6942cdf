/** "glove-1" of `urn:ngsi-ld:Device:demo:glove-1`; other texts are returned unchanged. */
export function shortName(urn: string): string {
  return urn.startsWith("urn:") ? urn.slice(urn.lastIndexOf(":") + 1) : urn;
}

/** Whether two ids (full URN or short name) name the same Task or Device. */
export function isSame(id: string | null, other: string | null): boolean {
  if (id === null || other === null) return false;
  return id === other || id.endsWith(`:${other}`) || other.endsWith(`:${id}`);
}
