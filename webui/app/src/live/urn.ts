/** "glove-1" of `urn:ngsi-ld:Device:demo:glove-1`; what is no URN stays as it is. */
export function shortName(urn: string): string {
  return urn.startsWith("urn:") ? urn.slice(urn.lastIndexOf(":") + 1) : urn;
}

/** Whether `id`, as a Task or Device is called in one place, is the one called `other` in another. */
export function isSame(id: string | null, other: string | null): boolean {
  if (id === null || other === null) return false;
  return id === other || id.endsWith(`:${other}`) || other.endsWith(`:${id}`);
}
