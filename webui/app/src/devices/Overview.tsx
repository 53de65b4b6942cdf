/** What a device is, where it is, and its values now. */
import { ImagePlus } from "lucide-react";
import { useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import type { DeviceDetails } from "~/api/generated/device-gateway";
import { errorText } from "~/api/http";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { FileButton } from "~/design/FileButton";
import { number } from "~/design/numbers";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { useCoarseNow } from "~/live/clock";
import type { RegisteredDeviceView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { mayDo } from "~/session/session";
import { pathOf, savePicture, SERVICE, type SymbolOf } from "./gateway";
import { connectionOf, digits, isoOf, outOfRange, spaced, valuesOf, type ShownValue } from "./values";

interface OverviewProps {
  device: RegisteredDeviceView;
  details: DeviceDetails;
  symbolOf: SymbolOf;
  onChanged: () => void;
}

const MINUTE_MS = 60_000;
const NO_BREAK = "\u00a0";

export function Overview({ device, details, symbolOf, onChanged }: OverviewProps) {
  const { t, i18n } = useTranslation("devices");
  const now = useCoarseNow(MINUTE_MS);
  const { description } = details;
  const { placement } = description;
  const metres = (values: readonly number[]) => values.map((value) => number(value, i18n.language)).join(" · ");
  const gripper = description.gripper;
  const facts: [string, ReactNode][] = [
    ["kind", t(`kind.${description.kind}`)],
    ["product", [description.manufacturer, description.model].filter((part) => part !== "").join(" ")],
    ["serialNumber", description.serialNumber],
    ["degreesOfFreedom", description.degreesOfFreedom],
    ["gripper", gripper == null ? null : `${t(`gripperType.${gripper.type ?? "parallel"}`)}${gripper.maxWidth == null ? "" : ` · ${number(gripper.maxWidth, i18n.language, { maximumFractionDigits: 3 })} m`}${gripper.maxForce == null ? "" : ` · ${number(gripper.maxForce, i18n.language)} N`}`],
    ["skills", description.skills?.join(", ")],
    ["location", placement?.location == null ? null : shortName(placement.location)],
    ["position", placement?.relativePosition == null ? null : `${metres(placement.relativePosition)} m`],
    ["coordinates", placement?.coordinates == null ? null : `${number(placement.coordinates[1], i18n.language, { maximumFractionDigits: 6 })}°, ${number(placement.coordinates[0], i18n.language, { maximumFractionDigits: 6 })}°`],
    ["connection", t(`connection.${connectionOf(device, details.certificateEndsAt, now)}`)],
    ["seen", device.seenAt === null ? null : <RelativeTime key="seen" at={isoOf(device.seenAt)} isStop />],
    ["entity", <code key="entity">{device.entity}</code>],
  ];
  return (
    <div className="device__columns">
      <Card title={t("overview.values")} className="device__values">
        <ValueTable values={valuesOf(device)} symbolOf={symbolOf} joints={details.description.joints ?? []} />
      </Card>
      <Card title={t("overview.about")}>
        <Picture device={device.name} version={device.updatedAt} hasPicture={details.files.includes("picture")} onChanged={onChanged} />
        {description.description !== "" && <p>{description.description}</p>}
        <dl className="device__facts">
          {facts
            .filter(([, value]) => value != null && value !== "")
            .map(([name, value]) => (
              <div key={name}>
                <dt>{t(`fact.${name}`)}</dt>
                <dd>{value}</dd>
              </div>
            ))}
        </dl>
      </Card>
    </div>
  );
}

function ValueTable({ values, symbolOf, joints }: { values: readonly ShownValue[]; symbolOf: SymbolOf; joints: NonNullable<DeviceDetails["description"]["joints"]> }) {
  const { t, i18n } = useTranslation("devices");
  const shown = new Set(values.map(({ name }) => name));
  const silent = joints.filter(({ name }) => !shown.has(name)).map(({ name, type }) => ({ name, unit: type === "prismatic" ? "MTR" : "C81", latest: null, sensor: null }));
  const all = [...values, ...silent];
  if (all.length === 0) return <p className="quiet">{t("sensors.noValues")}</p>;
  const rangeOf = ({ name, sensor }: ShownValue): [number | null, number | null] => {
    const joint = joints.find((each) => each.name === name);
    return sensor === null ? [joint?.lower ?? null, joint?.upper ?? null] : [sensor.minimum, sensor.maximum];
  };
  return (
    <div className="device__table" tabIndex={0} role="group" aria-label={t("overview.values")}>
      <table>
        <thead>
          <tr>
            <th scope="col">{t("overview.name")}</th>
            <th scope="col" data-number>{t("overview.value")}</th>
            <th scope="col">{t("overview.range")}</th>
            <th scope="col">{t("overview.age")}</th>
          </tr>
        </thead>
        <tbody>
          {all.map((value) => {
            const { name, latest } = value;
            const symbol = symbolOf(value.unit);
            const fault = outOfRange(value);
            return (
              <tr key={name} data-stale={latest === null || latest.stale || undefined}>
                <th scope="row">{t(`value.${name}`, { defaultValue: spaced(name) })}</th>
                <td data-number data-fault={fault !== null || undefined}>
                  {latest === null ? "–" : `${digits(latest.value, i18n.language)} ${symbol}`.trim()}
                </td>
                <td className="quiet">{rangeText(rangeOf(value), symbol, i18n.language)}</td>
                <td>
                  <span className="device__age">
                    {fault !== null && <StatusBadge tone="stop">{t("condition.outOfRange")}</StatusBadge>}
                    {latest?.stale === true && <StatusBadge tone="attention">{t("sensors.stale")}</StatusBadge>}
                    {latest === null ? t("sensors.noValueYet") : <RelativeTime at={isoOf(latest.t)} />}
                  </span>
                </td>
              </tr>
            );
          })}
        </tbody>
      </table>
    </div>
  );
}

/** A range that breaks only between its ends; empty where neither is known. */
function rangeText([least, most]: readonly [number | null, number | null], symbol: string, language: string): string {
  if (least === null && most === null) return "";
  const end = (value: number | null) => (value === null ? "–" : digits(value, language));
  return `${end(least)} … ${end(most)} ${symbol}`.trim().replaceAll(" ", NO_BREAK).replace(`…${NO_BREAK}`, "… ");
}

function Picture({ device, version, hasPicture, onChanged }: { device: string; version: number; hasPicture: boolean; onChanged: () => void }) {
  const { t } = useTranslation("devices");
  const [failure, setFailure] = useState<string | null>(null);
  const [saved, setSaved] = useState(0);
  const save = (file: File) => {
    savePicture(device, file).then(
      () => {
        setFailure(null);
        setSaved((before) => before + 1);
        onChanged();
      },
      (error: unknown) => setFailure(errorText(error)),
    );
  };
  return (
    <div className="device__picture">
      {hasPicture && <img src={`/api/${SERVICE}/${pathOf(device)}/picture?v=${version}-${saved}`} alt={t("picture.alt", { name: device })} />}
      {mayDo("configure") && (
        <FileButton types={["image/png", "image/jpeg", "image/webp"]} icon={<ImagePlus aria-hidden size={18} />} onFile={save}>
          {hasPicture ? t("picture.replace") : t("picture.add")}
        </FileButton>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </div>
  );
}
