/** The forms that add a device and change one, with its token and its deletion. */
import { FileKey, KeyRound, ShieldOff, Trash2 } from "lucide-react";
import { useMemo, useState, type SyntheticEvent } from "react";
import { useTranslation } from "react-i18next";
import type { CertificateView, DeviceDescription, DeviceDetails, TokenView } from "~/api/generated/device-gateway";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { exactTime } from "~/design/times";
import type { RegisteredDeviceView } from "~/live/messages";
import { faultText } from "~/tasks/faults";
import type { Draft } from "~/tasks/form";
import { FormFields } from "~/tasks/FormFields";
import { addDevice, deleteDevice, describeDevice, newCertificate, newToken, revokeCertificate, revokeToken, SERVICE } from "../gateway";
import { isoOf, titleOf } from "../values";
import { draftOfDescription, enteredDescription, fieldsOf, KINDS } from "./description";

type Units = Readonly<Record<string, string>>;

/** The units of the gateway, and those of a description that it has no symbol for. */
function withUnitsOf(units: Units, description: DeviceDescription): Units {
  const own = (description.sensors ?? []).flatMap(({ unit }) => (unit == null || unit in units ? [] : [[unit, ""] as const]));
  return { ...units, ...Object.fromEntries(own) };
}

interface DescriptionFormProps {
  initial: DeviceDescription;
  units: Units;
  act: string;
  onSave: (description: DeviceDescription) => Promise<unknown>;
  onClose?: () => void;
}

function DescriptionForm({ initial, units, act, onSave, onClose }: DescriptionFormProps) {
  const { t } = useTranslation(["devices", "common"]);
  const { t: ofForm } = useTranslation("tasks");
  const known = useMemo(() => withUnitsOf(units, initial), [units, initial]);
  const [draft, setDraft] = useState<Draft>(() => draftOfDescription(fieldsOf(t, known, initial.kind), initial));
  const kind = KINDS[Number(draft["kind"])];
  const fields = useMemo(() => fieldsOf(t, known, kind), [t, known, kind]);
  const [faults, setFaults] = useState<Record<string, string>>({});
  const [failure, setFailure] = useState<string | null>(null);
  const [busy, setBusy] = useState(false);
  const save = async (event: SyntheticEvent) => {
    event.preventDefault();
    if (busy) return;
    const { description, faults: found } = enteredDescription(fields, draft, initial);
    const texts = Object.fromEntries(Object.entries(found).map(([path, fault]) => [path, faultText(ofForm, fault)]));
    setFaults(texts);
    if (Object.keys(texts).length > 0) {
      setFailure(t("form.mend", { count: Object.keys(texts).length }));
      return;
    }
    setBusy(true);
    setFailure(null);
    try {
      await onSave(description);
    } catch (error) {
      setFailure(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  return (
    <form className="device-form" noValidate onSubmit={(event) => void save(event)}>
      <FormFields fields={fields} draft={draft} faults={faults} onChange={(path, entry) => setDraft((before) => ({ ...before, [path]: entry }))} />
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <div className="device-form__actions">
        {onClose !== undefined && <Button onPress={onClose}>{t("common:leaveIt")}</Button>}
        <Button type="submit" kind="main" isDisabled={busy}>
          {act}
        </Button>
      </div>
    </form>
  );
}

const NEW: DeviceDescription = { kind: "sensor" };

interface AddDeviceProps {
  units: Units;
  /** The name and the kind of a device that was found. */
  found: { name: string; kind: string };
  onClose: () => void;
  onAdded: (made: TokenView) => void;
}

export function AddDevice({ units, found, onClose, onAdded }: AddDeviceProps) {
  const { t } = useTranslation("devices");
  const kind = KINDS.find((other) => other === found.kind) ?? NEW.kind;
  const { value: templates, failure } = useServiceQuery<Record<string, DeviceDescription>>(SERVICE, "templates");
  const [name, setName] = useState(found.name);
  const [fault, setFault] = useState<string | undefined>();
  const [template, setTemplate] = useState("");
  const initial = templates?.[template] ?? { ...NEW, kind };
  const options = Object.entries(templates ?? {}).map(([value, { manufacturer, model }]) => ({ value, name: [manufacturer, model].filter((part) => part !== "").join(" ") || value }));
  return (
    <Card title={t("add.title")} className="device-add">
      <div className="device-add__first">
        <Field label={t("add.name")} hint={t("add.nameHint")} value={name} onChange={setName} error={fault} isRequired validationBehavior="aria" autoFocus />
        <Select label={t("add.template")} value={template} options={[{ value: "", name: t("add.noTemplate") }, ...options]} onChange={setTemplate} />
      </div>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <DescriptionForm
        key={template}
        initial={initial}
        units={units}
        act={t("add.act")}
        onClose={onClose}
        onSave={async (description) => {
          setFault(name.trim() === "" ? t("add.nameMissing") : undefined);
          if (name.trim() === "") throw new Error(t("add.nameMissing"));
          onAdded(await addDevice({ name: name.trim(), description }));
        }}
      />
    </Card>
  );
}

interface EditDeviceProps {
  device: RegisteredDeviceView;
  details: DeviceDetails;
  units: Units;
  onChanged: () => void;
  onToken: (made: TokenView) => void;
  /** Takes the key, which is shown only once: this form starts again when the device has changed. */
  onCertificate: (made: CertificateView) => void;
  onDeleted: () => void;
}

type Asked = "token" | "revoke" | "certificate" | "revokeCertificate" | "delete";

export function EditDevice({ device, details, units, onChanged, onToken, onCertificate, onDeleted }: EditDeviceProps) {
  const { t, i18n } = useTranslation("devices");
  const [asked, ask] = useState<Asked | null>(null);
  const { name } = device;
  const ends = details.certificateEndsAt;
  const acts: Record<Asked, () => Promise<unknown>> = {
    token: () => newToken(name).then(onToken),
    revoke: () => revokeToken(name).then(onChanged),
    certificate: () => newCertificate(name).then((made) => {
      onCertificate(made);
      onChanged();
    }),
    revokeCertificate: () => revokeCertificate(name).then(onChanged),
    delete: () => deleteDevice(name).then(onDeleted),
  };
  return (
    <>
      <Card title={t("access.title")}>
        <p>{t(device.hasToken ? "access.hasToken" : ends === null ? "access.noAccess" : "access.noToken")}</p>
        {ends !== null && <p>{t("access.hasCertificate", { end: exactTime(isoOf(ends), i18n.language) })}</p>}
        <div className="device-form__acts">
          <Button icon={<KeyRound aria-hidden size={18} />} onPress={() => ask("token")}>
            {t("access.token")}
          </Button>
          {device.hasToken && (
            <Button icon={<ShieldOff aria-hidden size={18} />} onPress={() => ask("revoke")}>
              {t("access.revoke")}
            </Button>
          )}
          <Button icon={<FileKey aria-hidden size={18} />} onPress={() => ask("certificate")}>
            {t("access.certificate")}
          </Button>
          {ends !== null && (
            <Button icon={<ShieldOff aria-hidden size={18} />} onPress={() => ask("revokeCertificate")}>
              {t("access.revokeCertificate")}
            </Button>
          )}
          <Button icon={<Trash2 aria-hidden size={18} />} onPress={() => ask("delete")}>
            {t("access.delete")}
          </Button>
        </div>
      </Card>
      <Card title={t("form.heading")}>
        <DescriptionForm initial={details.description} units={units} act={t("form.save")} onSave={(description) => describeDevice(name, description).then(onChanged)} />
      </Card>
      {asked !== null && (
        <ConfirmDialog isOpen onClose={() => ask(null)} title={t(`ask.${asked}.title`, { name: titleOf(device) })} act={t(`ask.${asked}.act`)} kind="stop" onAct={acts[asked]}>
          <p>{t(`ask.${asked}.means`)}</p>
        </ConfirmDialog>
      )}
    </>
  );
}
