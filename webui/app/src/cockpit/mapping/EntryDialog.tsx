/** The form of an entry of the mapping. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { AgentView } from "~/api/generated/task-orchestrator";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { TextBox } from "~/design/TextBox";
import { entryOf, KINDS, offered, parametersOf, references, TARGETS, type Draft } from "./mapping";
import type { MappingEntry } from "~/api/generated/task-orchestrator";

export interface EntryDialogProps {
  initial: Draft;
  isNew: boolean;
  agents: readonly AgentView[];
  onClose: () => void;
  onEntry: (entry: MappingEntry) => void;
}

export function EntryDialog({ initial, isNew, agents, onClose, onEntry }: EntryDialogProps) {
  const { t } = useTranslation("cockpit");
  const [draft, setDraft] = useState(initial);
  const set = <K extends keyof Draft>(name: K) => (value: Draft[K]) => setDraft((before) => ({ ...before, [name]: value }));
  const entry = entryOf(draft);
  const known = draft.target === "resource" ? references(agents) : offered(agents, draft.target);
  return (
    <ConfirmDialog
      isOpen
      onClose={onClose}
      title={t(isNew ? "mapping.add" : "mapping.change")}
      act={t(isNew ? "mapping.addAct" : "mapping.changeAct")}
      isDisabled={entry === null}
      onAct={() => {
        if (entry !== null) onEntry(entry);
        return Promise.resolve();
      }}
    >
      <Select label={t("mapping.kind")} value={draft.kind} options={KINDS.map((value) => ({ value, name: t(`mapping.kinds.${value}`) }))} onChange={(kind) => set("kind")(KINDS.find((one) => one === kind) ?? "definition")} />
      <Field label={t("mapping.name")} value={draft.name} onChange={set("name")} />
      <Select label={t("mapping.target")} value={draft.target} options={TARGETS.map((value) => ({ value, name: t(`mapping.targets.${value}`) }))} onChange={(target) => set("target")(TARGETS.find((one) => one === target) ?? "resource")} />
      <Field
        label={t(`mapping.targets.${draft.target}`)}
        hint={known.length === 0 ? undefined : t("mapping.known", { known: known.slice(0, 12).join(", ") })}
        value={draft.value}
        onChange={set("value")}
      />
      <Field label={t("mapping.definition")} hint={t("mapping.definitionHint")} value={draft.definition} onChange={set("definition")} />
      <TextBox label={t("mapping.parameters")} isCode value={draft.parameters} onChange={set("parameters")} error={parametersOf(draft.parameters) === null ? t("mapping.noJson") : undefined} />
    </ConfirmDialog>
  );
}
