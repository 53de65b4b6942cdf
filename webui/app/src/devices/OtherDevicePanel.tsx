/** A Device that exists only in the context broker: no service of this cell has registered it. */
import { ArrowLeft, Box } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Link, useLocation } from "wouter";
import { Battery } from "~/cell/Battery";
import { OpenAlerts } from "~/cell/objects/ObjectAlerts";
import { valueInWords } from "~/cell/objects/value";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { deviceTone } from "~/design/states";
import type { DeviceView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { addresses } from "~/places/addresses";
import { mayDo } from "~/session/session";
import { kindOfCategory } from "./values";

export function OtherDevicePanel({ device }: { device: DeviceView }) {
  const { t, i18n } = useTranslation(["cell", "devices", "system", "common"]);
  const [, go] = useLocation();
  const name = shortName(device.id);
  return (
    <section className="device" aria-label={name}>
      <header className="device__head">
        <Button kind="quiet" label={t("devices:back")} icon={<ArrowLeft aria-hidden size={20} />} onPress={() => go(addresses.devices())} />
        <Box aria-hidden size={24} />
        <h2>{name}</h2>
        {device.deviceState !== null && <StatusBadge tone={deviceTone[device.deviceState]}>{t(`common:deviceState.${device.deviceState}`)}</StatusBadge>}
        {device.batteryLevel !== null && <Battery level={device.batteryLevel} />}
      </header>
      <OpenAlerts entity={device.id} name={name} />
      <Card>
        <p>{t("other.means")}</p>
        {mayDo("configure") && <Link href={addresses.devices({ add: "yes", name, as: kindOfCategory(device.category) })}>{t("other.register")}</Link>}
        <dl className="device__facts">
          <div>
            <dt>{t("devices:fact.kind")}</dt>
            <dd>{device.category.map((category) => t(`system:device.kind.${category}`, { defaultValue: category })).join(", ") || "–"}</dd>
          </div>
          <div>
            <dt>{t("column.now")}</dt>
            <dd>{valueInWords(device.value, i18n.language) ?? t("devices:sensors.noValueYet")}</dd>
          </div>
          {device.observedAt !== null && (
            <div>
              <dt>{t("column.seen")}</dt>
              <dd>
                <RelativeTime at={device.observedAt} isStop />
              </dd>
            </div>
          )}
          <div>
            <dt>{t("devices:fact.entity")}</dt>
            <dd>
              <code>{device.id}</code>
            </dd>
          </div>
        </dl>
      </Card>
    </section>
  );
}
