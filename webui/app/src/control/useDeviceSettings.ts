/** The mappings of the input devices, which count whether their panel is shown or not. */
import { useEffect } from "react";
import type { Driver } from "./driver";
import { GAMEPAD, isLike, KEYBOARD, type GamepadMapping, type KeyboardMapping } from "./mapping";
import { TILT } from "./tilt";
import { useUserSetting } from "./useUserSetting";

const SCREEN = { gamma: 1 };

export type DeviceSettings = ReturnType<typeof useDeviceSettings>;

export function useDeviceSettings(driver: Driver) {
  const [keyboard, setKeyboard] = useUserSetting("control.keyboard", KEYBOARD, (value): value is KeyboardMapping => isLike(value, KEYBOARD));
  const [gamepad, setGamepad] = useUserSetting("control.gamepad", GAMEPAD, (value): value is GamepadMapping => isLike(value, GAMEPAD));
  const [screen, setScreen] = useUserSetting("control.screen", SCREEN, (value): value is typeof SCREEN => isLike(value, SCREEN));
  const [tilt, setTilt] = useUserSetting("control.tilt", TILT, (value): value is typeof TILT => isLike(value, TILT));
  useEffect(() => {
    driver.set({ keyboard, gamepad, screenGamma: screen.gamma, tiltGamma: tilt.gamma });
  }, [driver, keyboard, gamepad, screen, tilt]);
  return { keyboard, setKeyboard, gamepad, setGamepad, screen, setScreen, tilt, setTilt };
}
