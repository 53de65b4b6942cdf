/** One device: its values, commands, history, messages, model and settings. */
import { ArrowLeft } from "lucide-react";
import { useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { CertificateView, DeviceDetails, TokenView } from "~/api/generated/device-gateway";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { SegmentedControl } from "~/design/SegmentedControl";
import type { RegisteredDeviceView } from "~/live/messages";
import { useChoice } from "~/route/choice";
import { mayDo } from "~/session/session";
import { Battery } from "~/cell/Battery";
import { ROBOT_KINDS } from "~/cell/objects/cellObjects";
import { OpenAlerts } from "~/cell/objects/ObjectAlerts";
import { useRobotNames } from "~/live/names";
import { addresses } from "~/places/addresses";
import { CommandsPart } from "./commands/CommandsPart";
import { ConditionBadge } from "./ConditionBadge";
import { EditDevice } from "./form/DeviceForm";
import { hasJoints } from "./form/description";
import { pathOf, SERVICE, type SymbolOf } from "./gateway";
import { HistoryPart } from "./history/HistoryPart";
import { KindIcon } from "./KindIcon";
import { MessagesPart } from "./messages/MessagesPart";
import { ModelPart } from "./model/ModelPart";
import { Overview } from "./Overview";
import { titleOf } from "./values";

const PARTS = ["overview", "commands", "history", "messages", "model", "settings"] as const;
type Part = (typeof PARTS)[number];

export interface DevicePanelProps {
  device: RegisteredDeviceView;
  units: Readonly<Record<string, string>>;
  symbolOf: SymbolOf;
  onToken: (made: TokenView) => void;
  onCertificate: (made: CertificateView) => void;
  onClose: () => void;
}

export function DevicePanel({ device, units, symbolOf, onToken, onCertificate, onClose }: DevicePanelProps) {
  const { t } = useTranslation(["devices", "common"]);
  const [wanted, setPart] = useChoice<Part>("part", PARTS, "overview");
  const ofTool = useRobotNames().includes(device.name);
  const [changes, setChanges] = useState(0);
  const { value: details, failure, reload } = useServiceQuery<DeviceDetails>(SERVICE, pathOf(device.name), { revision: `${device.updatedAt} ${changes}` });
  const changed = () => setChanges((before) => before + 1);
  const parts = PARTS.filter((part) => {
    if (part === "model") return hasJoints(device.kind);
    if (part === "commands") return (details?.description.commands?.length ?? 0) > 0;
    return part !== "settings" || mayDo("configure");
  });
  const part: Part = parts.find((each) => each === wanted) ?? "overview";
  const show = (full: DeviceDetails): ReactNode => {
    switch (part) {
      case "overview":
        return <Overview device={device} details={full} symbolOf={symbolOf} onChanged={changed} />;
      case "commands":
        return <CommandsPart device={device} description={full.description} />;
      case "history":
        return <HistoryPart device={device} symbolOf={symbolOf} />;
      case "messages":
        return <MessagesPart device={device.name} />;
      case "model":
        return <ModelPart device={device} details={full} onChanged={changed} />;
      case "settings":
        return <EditDevice key={full.updatedAt} device={device} details={full} units={units} onChanged={changed} onToken={onToken} onCertificate={onCertificate} onDeleted={onClose} />;
    }
  };
  return (
    <section className="device" aria-label={titleOf(device)}>
      <header className="device__head">
        <Button kind="quiet" label={t("back")} icon={<ArrowLeft aria-hidden size={20} />} onPress={onClose} />
        <KindIcon kind={device.kind} size={24} />
        <h2>{titleOf(device)}</h2>
        <ConditionBadge device={device} />
        {device.batteryLevel !== null && <Battery level={device.batteryLevel} />}
        {(ofTool || (device.connected && ROBOT_KINDS.includes(device.kind))) && (
          <Link href={addresses.robot(device.name, "control")} className="device__control">
            {t("common:objectTab.control")}
          </Link>
        )}
      </header>
      <OpenAlerts entity={device.entity} name={device.name} />
      <SegmentedControl label={t("parts")} value={part} options={parts.map((each) => ({ value: each, name: t(`part.${each}`) }))} onChange={setPart} />
      {failure !== null && <ErrorMessage act={<Button onPress={reload}>{t("again")}</Button>}>{failure}</ErrorMessage>}
      {details !== null && show(details)}
    </section>
  );
}
