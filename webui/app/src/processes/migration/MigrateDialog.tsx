/** Continues a process in another version, after a check of what differs. */
import { useQuery } from "@tanstack/react-query";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { migrateProcess } from "~/api/actions";
import type { DefinitionWithActivities, ProcessView } from "~/api/generated/task-orchestrator";
import { errorText } from "~/api/http";
import { queryClient, useServiceQuery } from "~/api/useServiceQuery";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Select } from "~/design/Select";
import { MendDialog } from "../incidents/MendDialog";
import { SERVICE } from "../records";
import { Findings } from "./Findings";

export interface MigrateDialogProps {
  process: ProcessView;
  /** The latest version of its definition. */
  newest: number;
  onClose: () => void;
}

/** The name in a check, which is not stored. */
const CHECKED_BY = "-";
/** The obstacle that the variables of the dialog remove. */
const CAN_BE_SET = "migration.missing_parameter";

export function MigrateDialog({ process, newest, onClose }: MigrateDialogProps) {
  const { t } = useTranslation("processes");
  const [version, setVersion] = useState(newest === process.version ? newest - 1 : newest);
  const [mapping, setMapping] = useState<Record<string, string>>({});
  const definition = useServiceQuery<DefinitionWithActivities>(SERVICE, `definitions/${encodeURIComponent(process.definition)}?version=${version}`);
  const check = useQuery(
    {
      queryKey: ["migration", process.id, process.waiting.join(" "), version, mapping],
      queryFn: () => migrateProcess(process.id, { by: CHECKED_BY, version, mapping }, true),
    },
    queryClient,
  );
  const findings = check.data?.findings ?? [];
  const isImpossible = findings.some(({ obstacle, reasonCode }) => obstacle && reasonCode !== CAN_BE_SET);
  const versions = Array.from({ length: newest }, (_none, nth) => newest - nth).filter((one) => one !== process.version);
  return (
    <MendDialog
      title={t("migration.title", { title: process.name })}
      act={t("migration.act", { version })}
      means={t("migration.means")}
      variables={{ label: t("mend.variables"), hint: t("mend.variablesHint"), before: process.variables }}
      isDisabled={check.data === undefined || isImpossible}
      onClose={onClose}
      onAct={(decision) => migrateProcess(process.id, { ...decision, version, mapping })}
    >
      <Select
        label={t("migration.version")}
        value={String(version)}
        options={versions.map((one) => ({ value: String(one), name: t(one === newest ? "definition.latest" : "version", { version: one }) }))}
        onChange={(one) => {
          setVersion(Number(one));
          setMapping({});
        }}
      />
      {check.error !== null && <ErrorMessage>{errorText(check.error)}</ErrorMessage>}
      {check.data !== undefined && <p>{t(isImpossible ? "migration.impossible" : findings.length === 0 ? "migration.same" : "migration.possible")}</p>}
      <Findings
        findings={findings}
        targets={definition.value?.activities ?? []}
        mapping={mapping}
        onMap={(element, target) => setMapping(withTarget(mapping, element, target))}
      />
    </MendDialog>
  );
}

function withTarget(mapping: Readonly<Record<string, string>>, element: string, target: string): Record<string, string> {
  const others = Object.fromEntries(Object.entries(mapping).filter(([source]) => source !== element));
  return target === "" ? others : { ...others, [element]: target };
}
