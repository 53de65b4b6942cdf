/** Drive the robot with an input device of the device gateway: a haptic device, a handheld, motion capture or a glove. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { ControlView, InputDeviceView } from "~/api/generated/device-gateway";
import { errorText, requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Select } from "~/design/Select";
import { StatusBadge } from "~/design/StatusBadge";
import { gatewayMapping, initialMapping, isMappings, NO_MAPPINGS, type AxisKind, type DeviceMapping } from "./inputDevices";
import { DIRECTIONS, MAX_GAMMA, MIN_GAMMA } from "./mapping";
import { Slider } from "./Slider";
import type { Control } from "./useControl";
import { useUserSetting } from "./useUserSetting";

const SERVICE = "device-gateway";
const LOOK_EVERY_MS = 1000;

export function InputDevicePanel({ robot, control }: { robot: string; control: Control }) {
  const { t } = useTranslation("control");
  const { value, failure } = useServiceQuery<InputDeviceView[]>(SERVICE, "input-devices", { intervalMs: LOOK_EVERY_MS });
  const [chosen, choose] = useState("");
  const devices = value ?? [];
  const device = devices.find((one) => one.device === chosen) ?? devices.find((one) => one.control?.robot === robot && one.control.ended === null) ?? devices[0];
  if (failure !== null) return <ErrorMessage>{failure}</ErrorMessage>;
  if (device === undefined) return <p className="quiet">{t("inputs.none")}</p>;
  return (
    <>
      <Select label={t("inputs.device")} value={device.device} options={devices.map((one) => ({ value: one.device, name: one.title === "" ? one.device : `${one.title} (${one.device})` }))} onChange={choose} />
      <OneDevice key={device.device} device={device} robot={robot} control={control} />
    </>
  );
}

function OneDevice({ device: { device, axes, control: view }, robot, control }: { device: InputDeviceView; robot: string; control: Control }) {
  const { t, i18n } = useTranslation("control");
  const [stored, store] = useUserSetting("control.inputs", NO_MAPPINGS, isMappings);
  const [failure, setFailure] = useState<string | null>(null);
  const names = axes ?? [];
  const mapping = stored.devices[device] ?? initialMapping(names);
  const change = (next: DeviceMapping) => store({ devices: { ...stored.devices, [device]: next } });
  const drives = view !== null && view.ended === null;
  const path = `devices/${encodeURIComponent(device)}/control`;
  const ask = (method: "POST" | "DELETE", json?: object) => {
    setFailure(null);
    requestService(SERVICE, path, { method, ...(json === undefined ? {} : { json }) }).catch((error: unknown) => setFailure(errorText(error)));
  };
  const begin = () => {
    const { connection, driver } = control;
    // The device gets the control from this page, once the robot rests.
    connection.close();
    ask("POST", { robot, gamma: mapping.gamma, mix: driver.mix, arbitration: driver.arbitration, mapping: gatewayMapping(mapping, names), wait: true });
  };
  if (drives) return <Driving view={view} device={device} failure={failure} onEnd={() => ask("DELETE")} />;
  return (
    <>
      <Slider
        label={t("devices.gamma")}
        value={mapping.gamma}
        min={MIN_GAMMA}
        max={MAX_GAMMA}
        step={0.1}
        text={mapping.gamma.toLocaleString(i18n.language, { minimumFractionDigits: 1, maximumFractionDigits: 1 })}
        onChange={(gamma) => change({ ...mapping, gamma })}
      />
      {names.length > 0 && <AxisTable names={names} mapping={mapping} onChange={change} />}
      <p className="quiet small">{axes === null ? t("inputs.silent") : names.length === 0 ? t("inputs.velocities") : t("inputs.means")}</p>
      <Button kind="main" onPress={begin} isDisabled={axes === null}>
        {t("inputs.begin", { robot, device })}
      </Button>
      {view?.ended != null && <p className="quiet small">{t("inputs.ended", { reason: view.ended })}</p>}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </>
  );
}

function AxisTable({ names, mapping, onChange }: { names: readonly string[]; mapping: DeviceMapping; onChange: (mapping: DeviceMapping) => void }) {
  const { t } = useTranslation("control");
  const options = [
    { value: "", name: t("devices.unused") },
    ...names.flatMap((axis) => [
      { value: `1 ${axis}`, name: axis },
      { value: `-1 ${axis}`, name: t("inputs.reversed", { axis }) },
    ]),
  ];
  const setAxis = (direction: (typeof DIRECTIONS)[number], value: string) => {
    const others = Object.fromEntries(Object.entries(mapping.axes).filter(([name]) => name !== direction));
    const [sense, ...name] = value.split(" ");
    onChange({ ...mapping, axes: value === "" ? others : { ...others, [direction]: { axis: name.join(" "), sense: sense === "1" ? 1 : -1 } } });
  };
  return (
    <details className="input-devices__mapping">
      <summary>{t("devices.mapping")}</summary>
      <SegmentedControl
        label={t("inputs.kind")}
        value={mapping.kind}
        options={(["rate", "position"] as const).map((value) => ({ value, name: t(`inputs.${value}`) }))}
        onChange={(kind: AxisKind) => onChange({ ...mapping, kind })}
      />
      <div className="input-devices__pad">
        {DIRECTIONS.map((direction) => {
          const use = mapping.axes[direction];
          // An axis that the device does not send now stays in the mapping.
          const value = use === undefined ? "" : `${use.sense} ${use.axis}`;
          const all = options.some((one) => one.value === value) ? options : [...options, { value, name: use?.axis ?? "" }];
          return <Select key={direction} label={t(`use.${direction}`)} value={value} options={all} onChange={(next) => setAxis(direction, next)} />;
        })}
      </div>
      <Button onPress={() => onChange(initialMapping(names))}>{t("devices.standard")}</Button>
    </details>
  );
}

/** What the service of the robot says about the control with the device. */
interface DeviceState {
  type?: string;
  holder?: string | null;
  moves?: boolean;
  needsRelease?: boolean;
  limit?: string | null;
  fault?: string | null;
}

function Driving({ view, device, failure, onEnd }: { view: ControlView; device: string; failure: string | null; onEnd: () => void }) {
  const { t } = useTranslation("control");
  const state = view.state as DeviceState | null;
  const phase = state === null ? "connecting" : state.type === "waiting" ? "waiting" : state.moves === true ? "moves" : "rests";
  return (
    <>
      <p>
        <StatusBadge tone={phase === "moves" ? "attention" : phase === "rests" ? "ok" : "neutral"}>{t(`inputs.state.${phase}`, { robot: view.robot, name: state?.holder ?? "" })}</StatusBadge>
      </p>
      <p className="quiet small">{t(state?.needsRelease === true ? "hold.release" : "inputs.driving", { device, robot: view.robot })}</p>
      <Button kind="stop" onPress={onEnd}>
        {t("inputs.end", { device })}
      </Button>
      {state?.limit != null && <p className="quiet small">{t("hold.limit", { limit: state.limit })}</p>}
      {[view.error, state?.fault, failure].map((fault) => fault != null && <ErrorMessage key={fault}>{fault}</ErrorMessage>)}
    </>
  );
}
