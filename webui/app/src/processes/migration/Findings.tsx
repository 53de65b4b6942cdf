/** What differs for a process in another version: the obstacles first. */
import { Ban, Info } from "lucide-react";
import { useTranslation } from "react-i18next";
import type { DefinitionActivity, MigrationFinding } from "~/api/generated/task-orchestrator";
import { Select } from "~/design/Select";
import { localizedText } from "~/i18n/server";
import "./Findings.css";

export interface FindingsProps {
  findings: readonly MigrationFinding[];
  /** The activities of the new version, to which elements that are missing can be mapped. */
  targets?: readonly DefinitionActivity[];
  mapping?: Readonly<Record<string, string>>;
  onMap?: (element: string, target: string) => void;
}

export function Findings({ findings, targets = [], mapping = {}, onMap }: FindingsProps) {
  const { t } = useTranslation("processes");
  const sorted = [...findings].sort((one, other) => Number(other.obstacle) - Number(one.obstacle));
  return (
    <ul className="findings">
      {sorted.map((finding, nth) => (
        <li key={nth} className={finding.obstacle ? "findings__obstacle" : undefined}>
          {finding.obstacle ? <Ban aria-label={t("migration.obstacle")} size={18} /> : <Info aria-hidden size={18} />}
          <span>
            <strong>{finding.name === "" ? finding.element : finding.name}</strong>: {localizedText(finding, "reason")}
          </span>
        </li>
      ))}
      {onMap !== undefined && elementsToMap(findings, mapping).map((element) => (
        <li key={element}>
          <Select
            label={t("migration.mapTo", { element })}
            value={mapping[element] ?? ""}
            options={[{ value: "", name: t("migration.sameId") }, ...targets.map(({ id, name }) => ({ value: id, name: name === id ? id : `${name} (${id})` }))]}
            onChange={(target) => onMap(element, target)}
          />
        </li>
      ))}
    </ul>
  );
}

/** The elements with a token that are an obstacle, and those that were mapped because of it. */
export function elementsToMap(findings: readonly MigrationFinding[], mapping: Readonly<Record<string, string>>): string[] {
  const obstacles = findings.filter(({ obstacle, token }) => obstacle && token !== null).map(({ element }) => element);
  return [...new Set([...Object.keys(mapping), ...obstacles])];
}
