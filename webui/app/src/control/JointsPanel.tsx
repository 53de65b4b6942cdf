/** Jog single joints, while their buttons are held. */
import { Minus, Plus } from "lucide-react";
import { useTranslation } from "react-i18next";
import { labelOf, positionText, type JointDescription } from "~/robot/description";
import type { Driver } from "./driver";
import { HoldButton } from "./HoldButton";

export interface JointsPanelProps {
  driver: Driver;
  isOn: boolean;
  joints: readonly JointDescription[];
  position: readonly number[];
}

export function JointsPanel({ driver, isOn, joints, position }: JointsPanelProps) {
  const { t, i18n } = useTranslation("control");
  return (
    <ul className="joint-jog">
      {joints.map((joint, index) => {
        const name = labelOf(joint, i18n.language);
        const at = position[index];
        return (
          <li key={joint.name}>
            <span>{name}</span>
            <HoldButton isDisabled={!isOn} label={t("joints.less", { name })} onHold={(isHeld) => driver.pushJoint(index, isHeld ? -1 : 0)}>
              <Minus aria-hidden size={18} />
            </HoldButton>
            <output>{at === undefined ? "–" : positionText(joint, at, i18n.language)}</output>
            <HoldButton isDisabled={!isOn} label={t("joints.more", { name })} onHold={(isHeld) => driver.pushJoint(index, isHeld ? 1 : 0)}>
              <Plus aria-hidden size={18} />
            </HoldButton>
          </li>
        );
      })}
    </ul>
  );
}
