/** One line of what an object does now. */
import { useTranslation } from "react-i18next";
import { percent } from "~/design/numbers";
import { rate } from "~/design/times";
import { useUnits } from "~/devices/gateway";
import { digits, spaced, valuesOf } from "~/devices/values";
import type { GloveView, RegisteredDeviceView, RobotView, ServiceHealth } from "~/live/messages";
import { readable } from "~/live/readable";
import { shortName } from "~/live/urn";
import type { CellObject } from "./cellObjects";
import { valueInWords } from "./value";

const MAX_VALUES = 3;

export function useNowText(): (object: CellObject) => string {
  const { t, i18n } = useTranslation(["cell", "devices", "system", "common"]);
  const { symbolOf } = useUnits();

  const ofRobot = (view: RobotView) => {
    if (view.controlledBy !== null) return t("now.controlled", { name: view.controlledBy });
    if (view.awaitsConfirmation) return t("now.confirm");
    if (view.operation === null) return t("system:robot.idle");
    const operation = t(`system:robot.operation.${view.operation}`, { defaultValue: view.operation });
    return view.progress === null ? operation : t("now.progress", { operation, percent: percent(view.progress, i18n.language) });
  };
  const ofGlove = (view: GloveView) => {
    if (view.lost) return t("now.lost");
    if (view.task !== null) return t("now.asks", { task: view.task.description });
    const wearer = view.person === null ? t("now.nobody") : t("now.worn", { person: shortName(view.person) });
    return view.testing ? t("now.testing", { wearer }) : wearer;
  };
  const ofRegistered = (view: RegisteredDeviceView) => {
    const values = valuesOf(view).filter(({ latest }) => latest !== null && !latest.stale);
    if (values.length === 0) return view.connected ? t("devices:sensors.noValueYet") : t("now.silent");
    const shown = values.slice(0, MAX_VALUES).map(({ name, latest, unit }) => {
      const value = `${digits(latest?.value ?? 0, i18n.language)} ${symbolOf(unit)}`.trim();
      return `${t(`devices:value.${name}`, { defaultValue: spaced(name) })} ${value}`;
    });
    return values.length > MAX_VALUES ? t("now.more", { values: shown.join(" · "), count: values.length - MAX_VALUES }) : shown.join(" · ");
  };
  const ofService = (view: ServiceHealth) => {
    if (view.state !== "up" && view.detail !== null) return readable(view.detail);
    const busy = Object.entries(view.rates).filter(([, perSecond]) => perSecond > 0);
    if (busy.length > 0) return busy.map(([name, perSecond]) => `${rate(perSecond, i18n.language)} ${t(`system:service.rate.${name}`, { defaultValue: name })}`).join(" · ");
    return view.lastMessage === null ? "" : readable(view.lastMessage.text);
  };
  return (object) => {
    switch (object.kind) {
      case "robot":
        return object.view !== null ? ofRobot(object.view) : object.registered === null ? "" : ofRegistered(object.registered);
      case "glove":
        return ofGlove(object.view);
      case "device":
      case "sensor":
        return ofRegistered(object.view);
      case "other":
        return valueInWords(object.view.value, i18n.language) ?? t("devices:sensors.noValueYet");
      case "service":
        return ofService(object.view);
    }
  };
}
