/** The live 3D view of a robot in its cell. three.js loads with this module when it is first shown. */
import { RotateCcw, ZoomIn, ZoomOut } from "lucide-react";
import { useCallback, useEffect, useRef, useState } from "react";
import { useTranslation } from "react-i18next";
import { requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { useLive } from "~/live/hooks";
import type { JointState, RobotView } from "~/live/messages";
import type { LiveStore } from "~/live/store";
import type { DescriptionQuery, RobotDescription } from "~/robot/description";
import { useShownTheme } from "~/shell/theme";
import type { CellScene } from "./furniture";
import { type Palette, Stage } from "./stage";
import { InvalidDescription } from "./urdf";
import "./Robot3d.css";

type Showing = "loading" | "shown" | "noDescription" | "noWebgl" | "failed";

export default function Robot3d({ robot, ...query }: { robot: string } & DescriptionQuery) {
  const live = useLive();
  const followAll = useCallback(
    (stage: Stage) => {
      const ends = [follow(live, robot, stage), followNeighbours(live, robot, stage)];
      return () => ends.forEach((end) => end());
    },
    [live, robot],
  );
  return <RobotView robot={robot} follow={followAll} {...query} />;
}

export interface RobotViewProps extends DescriptionQuery {
  robot: string;
  /** Updates the stage until the returned function is called; another function draws the robot again. */
  follow: (stage: Stage) => () => void;
}

/** A robot of a description in 3D. */
export function RobotView({ robot, description, failure, follow }: RobotViewProps) {
  const { t } = useTranslation("system");
  const theme = useShownTheme();
  const host = useRef<HTMLDivElement>(null);
  const stage = useRef<Stage | null>(null);
  const [drawn, setDrawn] = useState<"shown" | "noDescription" | "noWebgl" | null>(null);
  const showing: Showing = drawn ?? (failure === null || description !== null ? "loading" : "failed");

  useEffect(() => {
    const place = host.current;
    if (place === null || description === null) return;
    let stop: (() => void) | undefined;
    let isGone = false;
    const draw = () => {
      if (isGone) return;
      try {
        stage.current = new Stage(place, description, palette(place));
      } catch (error) {
        setDrawn(error instanceof InvalidDescription ? "noDescription" : "noWebgl");
        return;
      }
      stop = follow(stage.current);
      setDrawn("shown");
    };
    queueMicrotask(draw);
    return () => {
      isGone = true;
      stop?.();
      stage.current?.dispose();
      stage.current = null;
    };
  }, [follow, description]);

  useEffect(() => {
    if (host.current !== null) stage.current?.restyle(palette(host.current));
  }, [theme]);

  return (
    <div className="robot3d">
      <div
        ref={host}
        className="robot3d__stage"
        {...(showing === "shown" ? { tabIndex: 0, role: "application", "aria-label": t("robot.view3d", { robot }) } : {})}
        onKeyDown={(event) => {
          if (event.ctrlKey || event.metaKey || event.altKey) return;
          if (stage.current?.key(event.key) === true) event.preventDefault();
        }}
      />
      {showing === "shown" && (
        <div className="robot3d__actions">
          <Button kind="quiet" label={t("robot.nearer")} icon={<ZoomIn aria-hidden size={18} />} onPress={() => stage.current?.key("+")} />
          <Button kind="quiet" label={t("robot.farther")} icon={<ZoomOut aria-hidden size={18} />} onPress={() => stage.current?.key("-")} />
          <Button kind="quiet" label={t("robot.resetView")} icon={<RotateCcw aria-hidden size={18} />} onPress={() => stage.current?.key("0")} />
        </div>
      )}
      {showing !== "shown" && (
        <div className="robot3d__note">
          {showing === "loading" ? (
            <p className="quiet">{t("robot.loading3d")}</p>
          ) : (
            <EmptyState title={t(`robot.${showing}.title`)}>{t(`robot.${showing}.means`, { robot })}</EmptyState>
          )}
        </div>
      )}
    </div>
  );
}

/** Update the 3D scene without React, because joints change 30 times a second. */
function follow(live: LiveStore, robot: string, stage: Stage): () => void {
  const [state, stream] = [`robot/${robot}` as const, `robot/${robot}/joints`];
  let scene = new AbortController();
  let arranged: string | null = null;
  const bend = (joints: JointState | undefined) => {
    if (joints !== undefined) stage.joints(joints.name, joints.position);
  };
  const onStream = () => bend(live.value(stream) as JointState | undefined);
  const onState = () => {
    const view = live.value(state);
    if (view === undefined) return;
    if (live.value(stream) === undefined) bend(view.joints);
    stage.gripper(view.gripper.closed, view.gripper.holds !== null);
    const arrangement = arrangementOf(view);
    if (arrangement === arranged) return;
    arranged = arrangement;
    scene.abort();
    scene = new AbortController();
    void arrange(robot, stage, scene.signal);
  };
  const ends = [live.subscribe(stream), live.watch(stream, onStream), live.watch(state, onState), () => scene.abort()];
  onState();
  return () => {
    for (const end of ends) end();
  };
}

/** Show the other robots of the cell, and follow their joints. */
function followNeighbours(live: LiveStore, robot: string, stage: Stage): () => void {
  const loading = new AbortController();
  const ends = [() => loading.abort()];
  const load = async () => {
    const cell = await requestService<{ robots: { id: string }[] }>("trajectory-tool", "cell", { signal: loading.signal });
    for (const { id } of cell.robots.filter((other) => other.id !== robot)) {
      const path = `robots/${encodeURIComponent(id)}/description`;
      const description = await requestService<RobotDescription>("trajectory-tool", path, { signal: loading.signal });
      if (loading.signal.aborted) return;
      stage.neighbour(id, description);
      const stream = `robot/${id}/joints`;
      const bend = () => {
        const joints = (live.value(stream) ?? live.value(`robot/${id}` as const)?.joints) as JointState | undefined;
        if (joints !== undefined) stage.neighbourJoints(id, joints.name, joints.position);
      };
      ends.push(live.subscribe(stream), live.watch(stream, bend));
      bend();
    }
  };
  load().catch(() => {
    // Without the cell, only this robot is shown.
  });
  return () => ends.forEach((end) => end());
}

/** Positions of parts change when one is gripped or released, a Task begins or ends, or the scene changes. */
function arrangementOf(view: RobotView): string {
  return `${view.gripper.holds ?? ""} ${view.task ?? ""} ${view.scene}`;
}

async function arrange(robot: string, stage: Stage, signal: AbortSignal): Promise<void> {
  let scene: CellScene | null = null;
  try {
    scene = await requestService<CellScene>("trajectory-tool", `robots/${encodeURIComponent(robot)}/scene`, { signal });
  } catch {
    // A robot without a scene is shown on an empty table.
  }
  if (!signal.aborted) stage.furnish(scene);
}

function palette(place: Element): Palette {
  const style = getComputedStyle(place);
  const colour = (name: keyof Palette) => style.getPropertyValue(`--robot3d-${name}`).trim();
  return {
    ground: colour("ground"),
    table: colour("table"),
    line: colour("line"),
    fixture: colour("fixture"),
    bin: colour("bin"),
    part: colour("part"),
    truepart: colour("truepart"),
    obstacle: colour("obstacle"),
    keepout: colour("keepout"),
    reduced: colour("reduced"),
    people: colour("people"),
  };
}
