/** By what a person is recognized at stations: badge number, QR code, PIN, gesture. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { encode } from "uqr";
import type { IdentifiersView } from "~/api/generated/accounts";
import { errorText, requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { PinPad } from "~/design/PinPad";
import { SERVICE, type UserView } from "./accounts";
import type { Secret } from "./SecretDialog";

const KINDS = ["badge", "qr", "pin", "gesture"] as const;
type Kind = (typeof KINDS)[number];

export function Identifiers({ user, onSecret }: { user: UserView; onSecret: (secret: Secret) => void }) {
  const { t } = useTranslation(["accounts", "common"]);
  const path = `users/${encodeURIComponent(user.subject)}/identifiers`;
  const { value, failure, reload } = useServiceQuery<IdentifiersView>(SERVICE, path);
  const [setting, setSetting] = useState<Exclude<Kind, "qr"> | null>(null);
  const [entered, setEntered] = useState("");
  const [fault, setFault] = useState<string | null>(null);
  const put = (kind: Kind, given: string | null) => requestService<IdentifiersView>(SERVICE, `${path}/${kind}`, { method: "PUT", json: { value: given } }).finally(reload);
  const act = (done: Promise<unknown>) => {
    setFault(null);
    void done.catch((error: unknown) => setFault(errorText(error)));
  };
  const newCode = async () => {
    const { qr } = await put("qr", "new");
    if (qr === null) return;
    onSecret({ title: t("identifiers.qrOf", { name: user.name }), means: t("identifiers.qrMeans"), value: qr, picture: <QrCode text={qr} label={t("identifiers.qrOf", { name: user.name })} /> });
  };
  const known = value?.kinds ?? [];
  return (
    <Card title={t("identifiers.title")}>
      <p className="quiet">{t("identifiers.means")}</p>
      {(fault ?? failure) !== null && <ErrorMessage>{fault ?? failure ?? ""}</ErrorMessage>}
      <ul className="accounts__rows">
        {KINDS.map((kind) => {
          const name = t(`common:station.methods.${kind}`);
          return (
            <li key={kind}>
              <div>
                <strong>{name}</strong>
                <p className="quiet">{known.includes(kind) ? t("identifiers.set") : t("identifiers.unset")}</p>
              </div>
              <span className="accounts__acts">
                <Button
                  label={t(known.includes(kind) ? "identifiers.changeOne" : "identifiers.setOne", { what: name })}
                  onPress={() => {
                    if (kind === "qr") act(newCode());
                    else setSetting(kind);
                  }}
                >
                  {t(kind === "qr" ? "identifiers.newCode" : known.includes(kind) ? "identifiers.change" : "identifiers.assign")}
                </Button>
                {known.includes(kind) && (
                  <Button kind="quiet" label={t("identifiers.removeOne", { what: name })} onPress={() => act(put(kind, null))}>
                    {t("identifiers.remove")}
                  </Button>
                )}
              </span>
            </li>
          );
        })}
      </ul>
      <ConfirmDialog
        isOpen={setting !== null}
        onClose={() => {
          setSetting(null);
          setEntered("");
        }}
        title={setting === null ? "" : t("identifiers.of", { what: t(`common:station.methods.${setting}`), name: user.name })}
        act={t("identifiers.assign")}
        isDisabled={entered.trim() === ""}
        onAct={() => put(setting ?? "badge", entered.trim())}
      >
        {setting === "pin" ? (
          <>
            <p className="quiet">{t("identifiers.pinMeans")}</p>
            <PinPad label={t("common:pin.label")} value={entered} onChange={setEntered} autoFocus />
          </>
        ) : (
          <Field label={setting === null ? "" : t(`common:station.methods.${setting}`)} hint={setting === null ? undefined : t(`identifiers.hint.${setting}`)} value={entered} onChange={setEntered} maxLength={100} autoFocus />
        )}
      </ConfirmDialog>
    </Card>
  );
}

/** The code as a picture to print: black on white also on a dark page. */
function QrCode({ text, label }: { text: string; label: string }) {
  const { data, size } = encode(text, { border: 4 });
  const path = data.flatMap((row, y) => row.flatMap((isDark, x) => (isDark ? [`M${x} ${y}h1v1h-1z`] : []))).join("");
  return (
    <svg className="accounts__qr" role="img" aria-label={label} viewBox={`0 0 ${size} ${size}`} shapeRendering="crispEdges">
      <rect width={size} height={size} fill="#fff" />
      <path d={path} fill="#000" />
    </svg>
  );
}
