/** A PIN by keys that can be pressed with a glove, or with a keyboard; its digits are not shown. */
import { Delete } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Button } from "./Button";
import { Field } from "./Field";
import "./PinPad.css";

const DIGITS = ["1", "2", "3", "4", "5", "6", "7", "8", "9", "", "0"] as const;
const MAX_DIGITS = 12;
export const MIN_PIN_DIGITS = 4;

export interface PinPadProps {
  label: string;
  value: string;
  onChange: (value: string) => void;
  autoFocus?: boolean;
}

export function PinPad({ label, value, onChange, autoFocus = false }: PinPadProps) {
  const { t } = useTranslation("common");
  const change = (next: string) => onChange(next.replace(/\D/g, "").slice(0, MAX_DIGITS));
  return (
    <div className="pin-pad" role="group" aria-label={label}>
      {/* No keyboard of the screen: the keys below are larger. */}
      <Field label={label} type="password" inputMode="none" autoComplete="off" size="large" value={value} onChange={change} autoFocus={autoFocus} />
      <div className="pin-pad__keys">
        {DIGITS.map((digit) =>
          digit === "" ? (
            <span key="gap" />
          ) : (
            <Button key={digit} size="large" onPress={() => change(value + digit)}>
              {digit}
            </Button>
          ),
        )}
        <Button size="large" label={t("pin.delete")} icon={<Delete aria-hidden size="1em" />} isDisabled={value === ""} onPress={() => change(value.slice(0, -1))} />
      </div>
    </div>
  );
}
