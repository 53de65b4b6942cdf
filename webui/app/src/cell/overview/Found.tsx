/** What announced itself and is not part of the cell yet: devices that only the broker knows, and connected gloves that nobody wears. */
import { Radar } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { DeviceDescription, TokenView } from "~/api/generated/device-gateway";
import type { PersonView } from "~/api/generated/gesture-controller";
import { requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { addDevice } from "~/devices/gateway";
import { TokenDialog } from "~/devices/TokenDialog";
import { kindOfCategory } from "~/devices/values";
import { KINDS } from "~/devices/form/description";
import type { DeviceView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { addresses } from "~/places/addresses";
import { mayDo } from "~/session/session";
import type { CellObject } from "../objects/cellObjects";
import { ObjectIcon } from "../objects/ObjectTable";
import "../objects/ObjectHistory.css";

const MAX_SHOWN = 3;

/** Whether an object announced itself and waits to be adopted. */
export function isFound(object: CellObject, hasGateway: boolean): boolean {
  return object.kind === "other" ? hasGateway : object.kind === "glove" && object.view.connected && object.view.person === null;
}

export function Found({ objects, hasGateway }: { objects: readonly CellObject[]; hasGateway: boolean }) {
  const { t } = useTranslation(["cell", "devices"]);
  const [chosen, setChosen] = useState<CellObject | null>(null);
  const [token, setToken] = useState<TokenView | null>(null);
  const found = mayDo("configure") ? objects.filter((object) => isFound(object, hasGateway)) : [];
  if (found.length === 0 && token === null) return null;
  const close = () => setChosen(null);
  return (
    <section className="found" aria-labelledby="found">
      <h2 id="found">
        <Radar aria-hidden size={20} /> {t("found.title", { count: found.length })}
      </h2>
      <ul className="object-history">
        {found.slice(0, MAX_SHOWN).map((object) => (
          <li key={object.key}>
            <ObjectIcon object={object} />
            <Link href={object.address}>{object.title}</Link>
            <span className="object-history__name quiet">{t(`found.${object.kind === "glove" ? "glove" : "device"}`)}</span>
            <Button onPress={() => setChosen(object)}>{t("found.adopt", { name: object.title })}</Button>
          </li>
        ))}
      </ul>
      {found.length > MAX_SHOWN && <Link href={addresses.cell({ kind: "other" })}>{t("found.more", { count: found.length - MAX_SHOWN })}</Link>}
      {chosen?.kind === "glove" && <AdoptGlove glove={chosen.name} onClose={close} />}
      {chosen?.kind === "other" && <AdoptDevice device={chosen.view} onAdopted={setToken} onClose={close} />}
      <TokenDialog made={token} onClose={() => setToken(null)} />
    </section>
  );
}

/** A glove belongs to the cell once somebody wears it: its calibration and gestures are theirs. */
function AdoptGlove({ glove, onClose }: { glove: string; onClose: () => void }) {
  const { t } = useTranslation("cell");
  const { value: people } = useServiceQuery<PersonView[]>("gesture-controller", "people");
  const [chosen, setChosen] = useState("");
  const person = chosen === "" ? (people?.[0]?.name ?? "") : chosen;
  const act = () => requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}/person`, { method: "PUT", json: { person } });
  return (
    <ConfirmDialog isOpen onClose={onClose} title={t("found.adopt", { name: glove })} act={t("found.act")} isDisabled={person === ""} onAct={act}>
      <p>{t(people?.length === 0 ? "found.noPeople" : "found.gloveMeans")}</p>
      <Select label={t("found.wearer")} value={person} options={(people ?? []).map((other) => ({ value: other.name, name: other.title ?? other.name }))} onChange={setChosen} />
    </ConfirmDialog>
  );
}

/** Register a device under the name of its entity, so that it stays the same object. */
function AdoptDevice({ device, onAdopted, onClose }: { device: DeviceView; onAdopted: (made: TokenView) => void; onClose: () => void }) {
  const { t } = useTranslation(["cell", "devices"]);
  const name = shortName(device.id);
  const [title, setTitle] = useState("");
  const [kind, setKind] = useState<string>(kindOfCategory(device.category) ?? "other");
  const act = () => addDevice({ name, description: { kind: kind as DeviceDescription["kind"], title: title.trim() } }).then(onAdopted);
  return (
    <ConfirmDialog isOpen onClose={onClose} title={t("found.adopt", { name })} act={t("found.act")} onAct={act}>
      <p>{t("found.deviceMeans")}</p>
      <Field label={t("devices:form.title")} value={title} onChange={setTitle} placeholder={name} />
      <Select label={t("kind")} value={kind} options={KINDS.map((value) => ({ value, name: t(`devices:kind.${value}`) }))} onChange={setKind} />
      <Link href={addresses.devices({ add: "yes", name, as: kind })}>{t("found.form")}</Link>
    </ConfirmDialog>
  );
}
