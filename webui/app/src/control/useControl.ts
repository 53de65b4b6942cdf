/** The control of one robot by this page: the connection, what the person asks for, and when it ends. */
import { useEffect, useRef, useState, useSyncExternalStore } from "react";
import { addKeyReceiver } from "~/shell/scans";
import { ControlConnection, type ControlSnapshot } from "./connection";
import { Driver } from "./driver";

export interface Control {
  connection: ControlConnection;
  driver: Driver;
  now: ControlSnapshot;
}

export function useControl(robot: string): Control {
  const [{ connection, driver }] = useState(() => {
    const made = new Driver();
    return { driver: made, connection: new ControlConnection(() => made.input()) };
  });
  const now = useSyncExternalStore(connection.subscribe, connection.snapshot);
  useEffect(() => () => connection.close(), [connection, robot]);
  useRelease(connection, driver);
  useKeyboard(connection, driver, now.phase === "on");
  return { connection, driver, now };
}

/** Where what is pressed is sent at once when it is released. */
export interface Sender {
  send: () => unknown;
}

/** Stop when the page is hidden or loses the focus: nobody sees the robot, or keys are released elsewhere. */
export function useRelease(connection: Sender, driver: Driver): void {
  useEffect(() => {
    const release = () => {
      driver.releaseAll();
      connection.send();
    };
    const onVisibility = () => {
      if (document.hidden) release();
    };
    addEventListener("blur", release);
    addEventListener("pagehide", release);
    document.addEventListener("visibilitychange", onVisibility);
    return () => {
      removeEventListener("blur", release);
      removeEventListener("pagehide", release);
      document.removeEventListener("visibilitychange", onVisibility);
    };
  }, [connection, driver]);
}

/**
 * Follow the pressed keys while the robot is controlled; keys meant for a text field or a dialog are not used. A direction
 * is taken from the page only while the control is held, so that its key keeps its use otherwise.
 */
export function useKeyboard(connection: Sender, driver: Driver, isOn: boolean): void {
  const on = useRef(isOn);
  useEffect(() => {
    on.current = isOn;
    if (!isOn) driver.releaseAll();
  }, [isOn, driver]);
  useEffect(() => {
    const down = (event: KeyboardEvent): boolean => {
      if (!on.current || event.ctrlKey || event.metaKey || event.altKey || isForField(event)) return false;
      const { keys } = driver.keyboard;
      if (!Object.values(keys).includes(event.code)) return false;
      // A key that was released by `releaseAll` counts only when it is pressed again.
      if (!event.repeat) driver.keyDown(event.code, event.timeStamp);
      if (event.code !== keys.hold && !driver.isPressed(keys.hold)) return false;
      event.preventDefault(); // a key that moves the robot does nothing else
      return true;
    };
    const up = (event: KeyboardEvent) => {
      if (!driver.keyUp(event.code)) return;
      event.preventDefault();
      event.stopPropagation();
      if (event.code === driver.keyboard.keys.hold) connection.send();
    };
    const remove = addKeyReceiver(down);
    addEventListener("keyup", up, true);
    return () => {
      remove();
      removeEventListener("keyup", up, true);
    };
  }, [connection, driver]);
}

function isForField(event: KeyboardEvent): boolean {
  const target = event.target as Element | null;
  return target?.closest("input:not([type=range], [type=checkbox]), textarea, select, [contenteditable], [role=dialog], [data-takes-keys]") != null;
}
