/** The content of the Processes page by its path: nothing, a process, a definition, an uploaded file, or offers. */

export type Place =
  | { kind: "nothing" }
  | { kind: "unknown"; path: string }
  | { kind: "process"; id: string }
  | { kind: "definition"; name: string }
  | { kind: "upload" }
  | { kind: "offers" };

const ROOT = "/processes";

/** Read a path under `/processes`; what cannot be read is unknown. */
export function placeOf(path: string): Place {
  const [first, second, ...more] = path.slice(ROOT.length).split("/").filter((part) => part !== "").map(plain);
  const unknown: Place = { kind: "unknown", path };
  if (first === undefined) return { kind: "nothing" };
  if (more.length > 0) return unknown;
  if (first === "definition") return second === undefined ? unknown : { kind: "definition", name: second };
  if (second !== undefined) return unknown;
  return first === "upload" || first === "offers" ? { kind: first } : { kind: "process", id: first };
}

/** The path of a place. */
export function pathOf(place: Place): string {
  switch (place.kind) {
    case "nothing":
      return ROOT;
    case "process":
      return `${ROOT}/${encodeURIComponent(place.id)}`;
    case "definition":
      return `${ROOT}/definition/${encodeURIComponent(place.name)}`;
    case "unknown":
      return place.path;
    case "upload":
    case "offers":
      return `${ROOT}/${place.kind}`;
  }
}

export function samePlace(one: Place, other: Place): boolean {
  return pathOf(one) === pathOf(other);
}

function plain(part: string): string {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}
