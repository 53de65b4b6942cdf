/** The icon of the kind of a device. */
import { Bot, BotMessageSquare, Box, Camera, Car, Gamepad2, HandGrab, Router, Thermometer, ToggleRight, Watch } from "lucide-react";
import { createElement } from "react";

const icons: Record<string, typeof Bot> = {
  robotArm: Bot,
  mobileRobot: Car,
  humanoid: BotMessageSquare,
  gripper: HandGrab,
  sensor: Thermometer,
  actuator: ToggleRight,
  wearable: Watch,
  inputDevice: Gamepad2,
  camera: Camera,
  edge: Router,
};

export function KindIcon({ kind, size = 20 }: { kind: string; size?: number }) {
  return createElement(icons[kind] ?? Box, { "aria-hidden": true, size });
}
