/** Arrange the panels: move, hide and show them. */
import { ChevronDown, ChevronUp, EyeOff } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Checkbox } from "~/design/Checkbox";
import { moved, PANELS, STANDARD, withShown, type Arrangement, type PanelId } from "./panels";

export interface ArrangeProps {
  arrangement: Arrangement;
  onArrange: (arrangement: Arrangement) => void;
}

export function PanelActions({ panel, arrangement, onArrange }: ArrangeProps & { panel: PanelId }) {
  const { t } = useTranslation("control");
  const name = t(`panel.${panel}`);
  return (
    <span className="control__arrange">
      <Button kind="quiet" label={t("arrange.earlier", { name })} icon={<ChevronUp aria-hidden size={18} />} onPress={() => onArrange(moved(arrangement, panel, -1))} />
      <Button kind="quiet" label={t("arrange.later", { name })} icon={<ChevronDown aria-hidden size={18} />} onPress={() => onArrange(moved(arrangement, panel, 1))} />
      <Button kind="quiet" label={t("arrange.hide", { name })} icon={<EyeOff aria-hidden size={18} />} onPress={() => onArrange(withShown(arrangement, panel, false))} />
    </span>
  );
}

export function ArrangeMenu({ arrangement, onArrange }: ArrangeProps) {
  const { t } = useTranslation("control");
  return (
    <details className="control__menu">
      <summary>{t("arrange.title")}</summary>
      <div className="control__choices">
        {PANELS.map((panel) => (
          <Checkbox key={panel} isSelected={!arrangement.hidden.includes(panel)} onChange={(isShown) => onArrange(withShown(arrangement, panel, isShown))}>
            {t(`panel.${panel}`)}
          </Checkbox>
        ))}
        <Button onPress={() => onArrange(STANDARD)}>{t("arrange.standard")}</Button>
      </div>
    </details>
  );
}
