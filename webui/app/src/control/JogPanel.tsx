/** Jog the tool: joysticks, speed, axes and the gripper. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { percent } from "~/design/numbers";
import { SegmentedControl } from "~/design/SegmentedControl";
import type { Driver } from "./driver";
import { Joystick } from "./Joystick";
import { Slider } from "./Slider";

/** The directions of the two joysticks. */
const USES = {
  move: { plane: ["x", "y"], lift: "z" },
  turn: { plane: ["ry", "rx"], lift: "rz" },
} as const;

/** With `isBase` for a robot that walks or rolls: forwards, sideways, and turning. */
export function JogPanel({ driver, isOn, isBase = false }: { driver: Driver; isOn: boolean; isBase?: boolean }) {
  const { t, i18n } = useTranslation("control");
  const [speed, setSpeed] = useState(driver.speed);
  const [frame, setFrame] = useState(driver.frame);
  const [turns, setTurns] = useState<"move" | "turn">("move");
  const { plane, lift } = USES[turns];
  return (
    <div className="jog">
      {!isBase && (
        <>
      <SegmentedControl
        label={t("jog.kind")}
        value={turns}
        options={[
          { value: "move", name: t("jog.move") },
          { value: "turn", name: t("jog.turn") },
        ]}
        onChange={setTurns}
      />
      <SegmentedControl
        label={t("jog.frame")}
        value={frame}
        options={[
          { value: "cell", name: t("jog.cell") },
          { value: "tool", name: t("jog.tool") },
        ]}
        onChange={(value) => {
          driver.set({ frame: value });
          setFrame(value);
        }}
      />
        </>
      )}
      <div className="jog__sticks">
        <Joystick
          key={turns}
          label={t(turns === "move" ? "jog.plane" : "jog.tilt")}
          onMove={(x, y) => {
            driver.push(plane[0], y);
            driver.push(plane[1], turns === "move" ? -x : x);
          }}
        />
        {isBase ? (
          <Joystick key="round" vertical label={t("jog.round")} onMove={(_, y) => driver.push("rz", y)} />
        ) : (
          <Joystick key={`${turns}-z`} vertical label={t(turns === "move" ? "jog.height" : "jog.round")} onMove={(_, y) => driver.push(lift, y)} />
        )}
      </div>
      <Slider
        label={t("jog.speed")}
        value={speed}
        min={0.05}
        max={1}
        step={0.05}
        text={percent(speed, i18n.language)}
        onChange={(value) => {
          driver.set({ speed: value });
          setSpeed(value);
        }}
      />
      {!isBase && (
      <div className="jog__gripper">
        <Button isDisabled={!isOn} onPress={() => driver.grip("open")}>
          {t("gripper.open")}
        </Button>
        <Button isDisabled={!isOn} onPress={() => driver.grip("close")}>
          {t("gripper.close")}
        </Button>
      </div>
      )}
    </div>
  );
}
