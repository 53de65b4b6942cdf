/** Input devices: their mapping and their scaling gamma, which the user keeps. */
import { useRef, useState, type KeyboardEvent } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Select } from "~/design/Select";
import { SCAN_GAP_MS } from "~/shell/scans";
import type { DeviceName } from "./driver";
import { InputDevicePanel } from "./InputDevicePanel";
import { keyName } from "./keyName";
import { BUTTONS, DIRECTIONS, GAMEPAD, KEYBOARD, MAX_GAMMA, MIN_GAMMA, type ButtonUse, type Direction, type GamepadMapping, type KeyboardMapping } from "./mapping";
import { Slider } from "./Slider";
import { TiltPanel } from "./TiltPanel";
import type { Control } from "./useControl";
import type { DeviceSettings } from "./useDeviceSettings";

const AXES = 6;
const PAD_BUTTONS = 17;

export function DevicesPanel({ robot, control, settings }: { robot: string; control: Control; settings: DeviceSettings }) {
  const { driver } = control;
  const { t, i18n } = useTranslation("control");
  const [device, setDevice] = useState<DeviceName | "other">("keyboard");
  const { keyboard, setKeyboard, gamepad, setGamepad, screen, setScreen, tilt, setTilt } = settings;
  const choice = (
    <SegmentedControl
      label={t("devices.device")}
      value={device}
      options={(["keyboard", "gamepad", "screen", "tilt", "other"] as const).map((value) => ({ value, name: t(`devices.${value}`) }))}
      onChange={setDevice}
    />
  );
  if (device === "other") {
    return (
      <div className="input-devices">
        {choice}
        <InputDevicePanel robot={robot} control={control} />
      </div>
    );
  }
  const gamma = { keyboard, gamepad, screen, tilt }[device].gamma;
  const setGamma = (value: number) => {
    if (device === "keyboard") setKeyboard({ ...keyboard, gamma: value });
    else if (device === "gamepad") setGamepad({ ...gamepad, gamma: value });
    else if (device === "tilt") setTilt({ gamma: value });
    else setScreen({ gamma: value });
  };
  return (
    <div className="input-devices">
      {choice}
      <Slider
        label={t("devices.gamma")}
        value={gamma}
        min={MIN_GAMMA}
        max={MAX_GAMMA}
        step={0.1}
        text={gamma.toLocaleString(i18n.language, { minimumFractionDigits: 1, maximumFractionDigits: 1 })}
        onChange={setGamma}
      />
      {device === "tilt" && <TiltPanel driver={driver} />}
      {(device === "keyboard" || device === "gamepad") && (
        <details className="input-devices__mapping">
          <summary>{t("devices.mapping")}</summary>
          {device === "keyboard" ? <KeyboardTable mapping={keyboard} onChange={setKeyboard} /> : <GamepadTable mapping={gamepad} onChange={setGamepad} />}
          <Button onPress={() => (device === "keyboard" ? setKeyboard(KEYBOARD) : setGamepad(GAMEPAD))}>{t("devices.standard")}</Button>
        </details>
      )}
    </div>
  );
}

function KeyboardTable({ mapping, onChange }: { mapping: KeyboardMapping; onChange: (mapping: KeyboardMapping) => void }) {
  const { t } = useTranslation("control");
  const names = Object.keys(KEYBOARD.keys) as (keyof KeyboardMapping["keys"])[];
  /** The use that gets the next key, and the key that is pressed for it. */
  const [waiting, setWaiting] = useState<keyof KeyboardMapping["keys"] | null>(null);
  const pressed = useRef<{ code: string; at: number } | null>(null);
  const down = (event: KeyboardEvent) => {
    if (waiting === null || ["Tab", "ShiftLeft", "ShiftRight", ""].includes(event.code)) return;
    event.preventDefault();
    if (event.code === "Escape") setWaiting(null);
    else if (!event.repeat) pressed.current = { code: event.code, at: event.timeStamp };
  };
  const up = (event: KeyboardEvent) => {
    const key = pressed.current;
    pressed.current = null;
    if (waiting === null || key === null) return;
    event.preventDefault(); // the release of Space would press the button again
    // A scanner holds its keys for a moment only.
    if (key.code !== event.code || event.timeStamp - key.at < SCAN_GAP_MS) return;
    assign(waiting, key.code);
    setWaiting(null);
  };
  const assign = (name: keyof KeyboardMapping["keys"], code: string) => {
    const keys = { ...mapping.keys };
    // A key has one use: the other use gets the key that becomes free.
    const other = names.find((one) => keys[one] === code);
    if (other !== undefined) keys[other] = keys[name];
    keys[name] = code;
    onChange({ ...mapping, keys });
  };
  return (
    <ul className="input-devices__keys">
      {names.map((name) => (
        <li key={name}>
          <span>{t(`use.${name}`)}</span>
          <button
            type="button"
            {...(waiting === name ? { "data-takes-keys": true } : {})}
            aria-label={waiting === name ? t("devices.pressFor", { use: t(`use.${name}`) }) : t("devices.change", { use: t(`use.${name}`), key: keyName(mapping.keys[name]) })}
            onClick={() => setWaiting(name)}
            onBlur={() => setWaiting(null)}
            onKeyDown={down}
            onKeyUp={up}
          >
            <kbd>{waiting === name ? t("devices.press") : keyName(mapping.keys[name])}</kbd>
          </button>
        </li>
      ))}
    </ul>
  );
}

function GamepadTable({ mapping, onChange }: { mapping: GamepadMapping; onChange: (mapping: GamepadMapping) => void }) {
  const { t } = useTranslation("control");
  const none = { value: "", name: t("devices.unused") };
  const axes = Array.from({ length: AXES }, (_, axis) => [1, -1].map((sense) => ({ value: `${axis} ${sense}`, name: t(sense === 1 ? "devices.axis" : "devices.axisReversed", { axis }) }))).flat();
  const buttons = Array.from({ length: PAD_BUTTONS }, (_, button) => ({ value: String(button), name: t("devices.button", { button }) }));
  const setAxis = (direction: Direction, value: string) => {
    const [axis, sense] = value.split(" ").map(Number);
    const use = axis === undefined || sense === undefined ? null : { axis, sense: sense === 1 ? (1 as const) : (-1 as const) };
    onChange({ ...mapping, axes: { ...mapping.axes, [direction]: use } });
  };
  const setButton = (button: ButtonUse, value: string) => onChange({ ...mapping, buttons: { ...mapping.buttons, [button]: Number(value) } });
  return (
    <div className="input-devices__pad">
      {DIRECTIONS.map((direction) => {
        const use = mapping.axes[direction];
        return <Select key={direction} label={t(`use.${direction}`)} value={use === null ? "" : `${use.axis} ${use.sense}`} options={[none, ...axes]} onChange={(value) => setAxis(direction, value)} />;
      })}
      {BUTTONS.map((button) => (
        <Select key={button} label={t(`use.${button}`)} value={String(mapping.buttons[button])} options={buttons} onChange={(value) => setButton(button, value)} />
      ))}
    </div>
  );
}
