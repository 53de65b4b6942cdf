/** Asks for what is recorded with an act on a process: the variables that it sets, the name and the reason. */
import { useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import type { MendRequest } from "~/api/generated/task-orchestrator";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { TextBox } from "~/design/TextBox";
import { useSession } from "~/session/session";
import { UserNameField, setUserName, useUserName } from "~/shell/userName";
import { editedVariables, variablesText, type Edited } from "./variables";

export interface MendDialogProps {
  title: string;
  /** What the button that does it says. */
  act: string;
  kind?: "main" | "stop";
  /** What follows from it. */
  means: string;
  /** The variables to edit, with their label; absent where the act sets none. */
  variables?: { label: string; hint: string; before: Readonly<Record<string, unknown>>; isRequired?: boolean };
  children?: ReactNode;
  isDisabled?: boolean;
  onClose: () => void;
  onAct: (decision: MendRequest) => Promise<unknown>;
}

const MAX_ROWS = 14;

export function MendDialog({ title, act, kind = "main", means, variables, children, isDisabled = false, onClose, onAct }: MendDialogProps) {
  const { t } = useTranslation("processes");
  const known = useUserName();
  const { hasAccounts } = useSession();
  const [given, setName] = useState(known);
  const name = hasAccounts ? known : given;
  const [why, setWhy] = useState("");
  // What was there when the dialog was opened: a process that continues does not change the text.
  const [before] = useState(variables?.before ?? {});
  const [text, setText] = useState(() => variablesText(before));
  const edited = editedVariables(text, before);
  const fault = useFaultText(edited);
  const changes = "values" in edited ? edited.values : {};
  const count = Object.keys(changes).length;
  const lacksChange = variables?.isRequired === true && count === 0;
  const decide = async () => {
    if (!hasAccounts) setUserName(name);
    await onAct({ by: name.trim(), why: why.trim(), ...(count === 0 ? {} : { variables: changes }) });
  };
  return (
    <ConfirmDialog
      isOpen
      onClose={onClose}
      title={title}
      act={act}
      kind={kind}
      isDisabled={isDisabled || name.trim() === "" || why.trim() === "" || fault !== undefined || lacksChange}
      onAct={decide}
    >
      <p>{means}</p>
      {children}
      {variables !== undefined && (
        <TextBox
          label={variables.label}
          hint={count === 0 ? variables.hint : t("mend.changes", { names: Object.keys(changes).join(", ") })}
          value={text}
          onChange={setText}
          error={fault}
          rows={Math.min(MAX_ROWS, Math.max(4, text.split("\n").length))}
          isCode
          autoFocus
        />
      )}
      <TextBox label={t("mend.why")} value={why} onChange={setWhy} maxLength={1000} isRequired validationBehavior="aria" autoFocus={variables === undefined} />
      <UserNameField value={name} onChange={setName} hint={t("mend.nameHint")} />
    </ConfirmDialog>
  );
}

function useFaultText(edited: Edited): string | undefined {
  const { t } = useTranslation("processes");
  if ("values" in edited) return undefined;
  switch (edited.fault) {
    case "syntax":
      return edited.line === null ? t("mend.fault.syntax") : t("mend.fault.syntaxAt", { line: edited.line });
    case "notAnObject":
      return t("mend.fault.notAnObject");
    case "name":
      return t("mend.fault.name", { name: edited.name });
    case "removed":
      return t("mend.fault.removed", { name: edited.name });
  }
}
