/** The humanoid live in 3D on the desk page. three.js loads with this module when it is first shown. */
import { RotateCcw, ZoomIn, ZoomOut } from "lucide-react";
import { useEffect, useRef, useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { InvalidDescription } from "~/robot3d/urdf";
import { useShownTheme } from "~/shell/theme";
import "~/robot3d/Robot3d.css";
import { DeskView, type DeskColours } from "./deskView";
import type { HumanoidModel, LiveDocument, Place } from "./humanoid";

/** What is shown: live documents, or those of a recording. */
export interface DocumentSource {
  subscribe: (listener: () => void) => () => void;
  snapshot: () => { document: LiveDocument | null };
}

export interface Humanoid3dProps {
  name: string;
  urdf: string;
  model: HumanoidModel;
  source: DocumentSource;
  /** Called for a press on the horizontal plane through `target`; null where nothing is chosen. */
  onPick: ((place: Place) => void) | null;
  /** Where the next ball is to land, in the frame of the feet. */
  target: Place | null;
}

export default function Humanoid3d({ name, urdf, model, source, onPick, target }: Humanoid3dProps) {
  const { t } = useTranslation(["humanoid", "system"]);
  const theme = useShownTheme();
  const host = useRef<HTMLDivElement>(null);
  const view = useRef<DeskView | null>(null);
  const [showing, setShowing] = useState<"loading" | "shown" | "noDescription" | "noWebgl">("loading");
  const pick = useRef({ onPick, target, pickHeightM: target?.[2] ?? 0 });

  useEffect(() => {
    pick.current = { onPick, target, pickHeightM: target?.[2] ?? 0 };
    if (view.current !== null) Object.assign(view.current, pick.current);
  }, [onPick, target]);

  useEffect(() => {
    const place = host.current;
    if (place === null) return;
    let stop: (() => void) | undefined;
    let isGone = false;
    queueMicrotask(() => {
      if (isGone) return;
      try {
        view.current = new DeskView(place, urdf, model, coloursOf(place));
      } catch (error) {
        setShowing(error instanceof InvalidDescription ? "noDescription" : "noWebgl");
        return;
      }
      Object.assign(view.current, pick.current);
      const show = () => {
        const { document } = source.snapshot();
        if (document !== null) view.current?.show(document);
      };
      stop = source.subscribe(show);
      show();
      setShowing("shown");
    });
    return () => {
      isGone = true;
      stop?.();
      view.current?.dispose();
      view.current = null;
    };
  }, [urdf, model, source]);

  useEffect(() => {
    if (host.current !== null) view.current?.recolour(coloursOf(host.current));
  }, [theme]);

  return (
    <div className="robot3d humanoid3d">
      <div
        ref={host}
        className="robot3d__stage"
        data-picks={onPick !== null || undefined}
        {...(showing === "shown" ? { tabIndex: 0, role: "application", "aria-label": t("view3d", { humanoid: name }) } : {})}
        onKeyDown={(event) => {
          if (event.ctrlKey || event.metaKey || event.altKey) return;
          if (view.current?.key(event.key) === true) event.preventDefault();
        }}
      />
      {showing === "shown" ? (
        <div className="robot3d__actions">
          <Button kind="quiet" label={t("system:robot.nearer")} icon={<ZoomIn aria-hidden size={18} />} onPress={() => view.current?.key("+")} />
          <Button kind="quiet" label={t("system:robot.farther")} icon={<ZoomOut aria-hidden size={18} />} onPress={() => view.current?.key("-")} />
          <Button kind="quiet" label={t("system:robot.resetView")} icon={<RotateCcw aria-hidden size={18} />} onPress={() => view.current?.key("0")} />
        </div>
      ) : (
        <div className="robot3d__note">
          {showing === "loading" ? <p className="quiet">{t("system:robot.loading3d")}</p> : <EmptyState title={t(`system:robot.${showing}.title`)}>{t(`system:robot.${showing}.means`, { robot: name })}</EmptyState>}
        </div>
      )}
    </div>
  );
}

function coloursOf(place: Element): DeskColours {
  const style = getComputedStyle(place);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  return {
    background: colour("--robot3d-ground"),
    ground: colour("--robot3d-table"),
    line: colour("--robot3d-line"),
    com: colour("--accent"),
    zmp: colour("--stop"),
    polygon: colour("--ok"),
    steps: colour("--robot3d-fixture"),
    landings: { left: colour("--robot3d-people"), right: colour("--robot3d-part") },
    force: colour("--robot3d-reduced"),
    ball: colour("--robot3d-part"),
    target: colour("--accent"),
    person: colour("--robot3d-people"),
  };
}
