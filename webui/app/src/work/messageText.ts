/** Messages of the controller in the language of the page; unknown messages stay in English. */
import { useTranslation } from "react-i18next";
import { useGestureName } from "~/hand/Hand";
import type { Message } from "~/live/messages";

export function useMessageText(): (message: Message) => string {
  const { t, i18n } = useTranslation("work");
  const nameOf = useGestureName();
  const fingers = (names: unknown) =>
    new Intl.ListFormat(i18n.language).format(
      Array.isArray(names) ? names.map((name) => t(`advice.finger.${String(name)}`)) : [],
    );
  return ({ key, values, text }) => {
    if (!i18n.exists(`work:message.${key}`)) return text;
    const advice = (["stretch", "bend"] as const)
      .filter((way) => Array.isArray(values[way]) && values[way].length > 0)
      .map((way) => t(`advice.${way}`, { fingers: fingers(values[way]) }))
      .join(", ");
    const gesture = (name: unknown) => (typeof name === "string" ? nameOf(name) : "");
    return t(`message.${key}`, { ...values, advice, gesture: gesture(values["gesture"]), shown: gesture(values["shown"]) });
  };
}
