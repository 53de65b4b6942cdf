/** The commands of a device: sending one by its schema, and those that were sent with their states. */
import { Send, X } from "lucide-react";
import { useState, type SyntheticEvent } from "react";
import { useTranslation } from "react-i18next";
import type { CommandSpecification, CommandView, DeviceDescription } from "~/api/generated/device-gateway";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { percent, typedNumber } from "~/design/numbers";
import { RelativeTime } from "~/design/RelativeTime";
import { Select } from "~/design/Select";
import { StatusBadge, type Tone } from "~/design/StatusBadge";
import { localizedText } from "~/i18n/server";
import type { RegisteredDeviceView } from "~/live/messages";
import { mayDo } from "~/session/session";
import { faultText } from "~/tasks/faults";
import { draftOf, type Draft } from "~/tasks/form";
import { FormFields } from "~/tasks/FormFields";
import { cancelCommand, pathOf, sendCommand, SERVICE } from "../gateway";
import { isoOf, spaced, titleOf } from "../values";
import { commandFields, enteredParameters } from "./schema";

const OPEN = ["queued", "sent", "accepted", "running"];
const OPEN_MS = 1000;
const ENDED_MS = 5000;
const SHOWN = 50;
const DEFAULT_TIMEOUT_S = 60;
const tones: Record<string, Tone> = { queued: "neutral", sent: "accent", accepted: "accent", running: "accent", done: "ok", failed: "stop", cancelled: "neutral", expired: "attention", unknown: "attention" };
const NONE: readonly CommandView[] = [];

export function CommandsPart({ device, description }: { device: RegisteredDeviceView; description: DeviceDescription }) {
  const { t } = useTranslation("devices");
  const [isOpen, setOpen] = useState(false);
  const { value, failure, reload } = useServiceQuery<CommandView[]>(SERVICE, `${pathOf(device.name)}/commands?limit=${SHOWN}`, { intervalMs: isOpen ? OPEN_MS : ENDED_MS });
  const sent = value ?? NONE;
  const hasOpen = sent.some(({ state }) => OPEN.includes(state));
  if (hasOpen !== isOpen) setOpen(hasOpen);
  const commands = description.commands ?? [];
  const [name, setName] = useState(commands[0]?.name ?? "");
  const command = commands.find((each) => each.name === name) ?? commands[0];
  return (
    <div className="device__columns">
      <Card title={t("commands.send")}>
        {command === undefined || !mayDo("moveRobots") ? (
          <p className="quiet">{t("commands.notAllowed")}</p>
        ) : (
          <>
            <Select
              label={t("commands.command")}
              value={command.name}
              options={commands.map((each) => ({ value: each.name, name: `${spaced(each.name)} (${t(`commandKind.${each.kind}`)})` }))}
              onChange={setName}
            />
            <CommandForm key={command.name} device={device} command={command} joints={description.joints ?? []} onSent={reload} />
          </>
        )}
      </Card>
      <Card title={t("commands.sent")}>
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        {value !== null && sent.length === 0 && <p className="quiet">{t("commands.none")}</p>}
        <ol className="command-list">
          {sent.map((each) => (
            <SentCommand key={each.id} command={each} onChanged={reload} />
          ))}
        </ol>
      </Card>
    </div>
  );
}

function newId(): string {
  return `page-${Date.now().toString(36)}-${Math.random().toString(36).slice(2, 10)}`;
}

function CommandForm({ device, command, joints, onSent }: { device: RegisteredDeviceView; command: CommandSpecification; joints: NonNullable<DeviceDescription["joints"]>; onSent: () => void }) {
  const { t, i18n } = useTranslation("devices");
  const { t: ofForm } = useTranslation("tasks");
  const [fields] = useState(() => commandFields(command, joints, device.values));
  const [draft, setDraft] = useState<Draft>(() => draftOf(fields, {}));
  const [timeout, setTimeoutText] = useState(String(DEFAULT_TIMEOUT_S));
  const [faults, setFaults] = useState<Record<string, string>>({});
  const [failure, setFailure] = useState<string | null>(null);
  const [ready, setReady] = useState<Record<string, unknown> | null>(null);
  // The same press twice, or an answer lost on the way, never sends two.
  const [id, setId] = useState(newId);
  const send = async (parameters: Record<string, unknown>) => {
    const timeoutS = typedNumber(timeout, i18n.language) ?? DEFAULT_TIMEOUT_S;
    await sendCommand(device.name, { name: command.name, parameters, timeoutS, id });
    setId(newId());
    onSent();
  };
  const submit = (event: SyntheticEvent) => {
    event.preventDefault();
    const { parameters, faults: found } = enteredParameters(fields, draft);
    setFaults(Object.fromEntries(Object.entries(found).map(([path, fault]) => [path, faultText(ofForm, fault)])));
    setFailure(null);
    if (Object.keys(found).length > 0) return;
    if (command.kind === "motion") setReady(parameters);
    else send(parameters).catch((error: unknown) => setFailure(errorText(error)));
  };
  const act = t("commands.act", { command: spaced(command.name) });
  return (
    <form className="device-form" noValidate onSubmit={submit}>
      {command.description !== undefined && command.description !== "" && <p>{command.description}</p>}
      <p className="quiet small">{t(`commands.means.${command.kind}`)}</p>
      <FormFields fields={fields} draft={draft} faults={faults} onChange={(path, entry) => setDraft((before) => ({ ...before, [path]: entry }))} />
      <Field label={t("commands.timeout")} value={timeout} onChange={setTimeoutText} inputMode="decimal" />
      {command.kind === "motion" && !device.connected && <p className="quiet">{t("commands.away")}</p>}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <div className="device-form__actions">
        <Button type="submit" kind="main" icon={<Send aria-hidden size={18} />}>
          {act}
        </Button>
      </div>
      <ConfirmDialog isOpen={ready !== null} onClose={() => setReady(null)} title={t("commands.ask", { name: titleOf(device) })} act={act} onAct={() => send(ready ?? {})}>
        <p>{t("commands.moves")}</p>
      </ConfirmDialog>
    </form>
  );
}

function SentCommand({ command, onChanged }: { command: CommandView; onChanged: () => void }) {
  const { t, i18n } = useTranslation("devices");
  const [failure, setFailure] = useState<string | null>(null);
  const { state, progress, parameters, result, reason } = command;
  const isOpen = OPEN.includes(state);
  const cancel = () => {
    cancelCommand(command.device, command.id).then(onChanged, (error: unknown) => setFailure(errorText(error)));
  };
  return (
    <li className="command">
      <div className="command__head">
        <strong>{spaced(command.name)}</strong>
        <StatusBadge tone={tones[state] ?? "neutral"}>
          {t(`commandState.${state}`, { defaultValue: state })}
          {isOpen && progress !== null && ` ${percent(progress, i18n.language)}`}
        </StatusBadge>
        <span className="quiet">
          <RelativeTime at={isoOf(command.createdAt)} />
        </span>
        {isOpen && mayDo("moveRobots") && (
          <Button icon={<X aria-hidden size={18} />} onPress={cancel}>
            {t("commands.cancel")}
          </Button>
        )}
      </div>
      {Object.keys(parameters).length > 0 && <code>{JSON.stringify(parameters)}</code>}
      {reason !== null && <p>{localizedText(command, "reason")}</p>}
      {result !== null && Object.keys(result).length > 0 && (
        <p>
          {t("commands.result")} <code>{JSON.stringify(result)}</code>
        </p>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </li>
  );
}
