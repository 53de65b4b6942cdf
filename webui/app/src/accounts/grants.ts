/** Drafts of grants: a role for everything, for some of what exists, or for a pattern. */
import { useServiceQuery } from "~/api/useServiceQuery";
import { shortName } from "~/live/urn";
import { EVERYTHING, type GrantBody } from "./accounts";

export const SCOPES = ["all", "some", "pattern"] as const;
export type Scope = (typeof SCOPES)[number];

export interface GrantDraft {
  role: string;
  scope: Scope;
  chosen: ReadonlySet<string>;
  pattern: string;
}

export const NEW_DRAFT: GrantDraft = { role: "operator", scope: "all", chosen: new Set(), pattern: "" };

const KINDS = ["Device", "ProcessDefinition", "Person"] as const;
export type Kind = (typeof KINDS)[number];

/** A resource that exists: an entity of the broker. */
export interface Resource {
  id: string;
  kind: Kind;
  name: string;
}

/** The grants of a draft; none while it is incomplete. */
export function grantsOf({ role, scope, chosen, pattern }: GrantDraft): GrantBody[] {
  if (scope === "all") return [{ role, resource: EVERYTHING }];
  if (scope === "pattern") return pattern.trim() === "" ? [] : [{ role, resource: pattern.trim() }];
  return [...chosen].map((resource) => ({ role, resource }));
}

/** What a grant can name: robots, gloves and other devices, process definitions, people. */
export function useResources(): { resources: readonly Resource[]; failure: string | null } {
  const { value, failure } = useServiceQuery<{ id: string; type: string }[]>(
    "context-broker",
    `ngsi-ld/v1/entities?type=${KINDS.join(",")}&pick=id,type&limit=1000`,
  );
  return { resources: resourcesOf(value ?? []), failure };
}

export function resourcesOf(entities: readonly { id: string; type: string }[]): Resource[] {
  return entities
    .flatMap(({ id, type }) => {
      const kind = KINDS.find((one) => one === type);
      return kind === undefined ? [] : [{ id, kind, name: shortName(id) }];
    })
    .sort((a, b) => KINDS.indexOf(a.kind) - KINDS.indexOf(b.kind) || a.name.localeCompare(b.name, undefined, { numeric: true }));
}
