/** Devices: what the context broker knows of each, whoever wrote it there. */
import { Cpu } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Ago } from "~/design/Ago";
import { Empty } from "~/design/Empty";
import { State } from "~/design/State";
import { deviceTone } from "~/design/states";
import { useFamily } from "~/live/hooks";
import type { DeviceView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { Cell, Row, Rows } from "../Rows";
import { Battery } from "../Battery";
import { valueInWords } from "./value";

export function DevicesPanel() {
  const { t } = useTranslation("system");
  const devices = useFamily("device");
  if (devices.length === 0) {
    return <Empty icon={<Cpu aria-hidden size={32} />} title={t("device.none.title")}>{t("device.none.means")}</Empty>;
  }
  const heads = ["device", "category", "state", "battery", "value", "seen"].map((head) => t(`device.${head}`));
  return (
    <Rows label={t("tab.devices")} heads={heads} widths={["23%", "10%", "14%", "10%", "29%", "14%"]}>
      {devices.map((device) => (
        <Device key={device.id} device={device} heads={heads} />
      ))}
    </Rows>
  );
}

function Device({ device, heads }: { device: DeviceView; heads: readonly string[] }) {
  const { t } = useTranslation(["system", "common"]);
  const [name = "", category = "", state = "", battery = "", value = "", seen = ""] = heads;
  return (
    <Row>
      <Cell head={name}>
        <span className="rows__name">{shortName(device.id)}</span>
        <p className="rows__why rows__urn">{device.id}</p>
      </Cell>
      <Cell head={category}>
        {device.category.map((one) => t(`device.kind.${one}`, { defaultValue: one })).join(", ")}
      </Cell>
      <Cell head={state}>
        {device.deviceState !== null && (
          <State tone={deviceTone[device.deviceState]}>{t(`common:deviceState.${device.deviceState}`)}</State>
        )}
      </Cell>
      <Cell head={battery}>{device.batteryLevel !== null && <Battery level={device.batteryLevel} />}</Cell>
      <Cell head={value}>{valueInWords(device.value)}</Cell>
      <Cell head={seen}>{device.observedAt !== null && <Ago at={device.observedAt} />}</Cell>
    </Row>
  );
}
