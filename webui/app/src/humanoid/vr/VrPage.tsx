/** The person's view of the humanoid: virtual reality with a headset, or the pointer without one. */
import { Glasses, MousePointer2 } from "lucide-react";
import { useEffect, useRef, useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { errorText, requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { Checkbox } from "~/design/Checkbox";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Loading } from "~/design/Loading";
import { SegmentedControl } from "~/design/SegmentedControl";
import { StatusBadge } from "~/design/StatusBadge";
import { addresses } from "~/places/addresses";
import { InvalidDescription } from "~/robot3d/urdf";
import { mayDo } from "~/session/session";
import { SERVICE, type HumanoidModel, type LiveDocument } from "../humanoid";
import { StopBar } from "../StopBar";
import type { Posture } from "./bounds";
import { hasHeadset } from "./headset";
import type { Quantiles } from "./durations";
import type { PanelContent } from "./panel";
import type { Act } from "./words";
import { MEASURED, type Measured } from "./measuring";
import { type Using, VrView } from "./vrView";
import "./VrPage.css";

type Application = "juggling" | "walking";
const GOALS: Readonly<Record<Application, object>> = { juggling: { throws: 10 }, walking: { seconds: 120 } };
const SHOWN_EVERY_MS = 500;
/** Of our part of the way from a pose to the picture of a state that has it: all but the drawing. */
const AIM_MS = 30;

interface Shown {
  document: LiveDocument | null;
  figures: Record<Measured, Quantiles | null> | null;
}

export default function VrPage() {
  const { t } = useTranslation(["humanoidVr", "common", "health", "humanoid"]);
  const { value: model, failure } = useServiceQuery<HumanoidModel>(SERVICE, "model");
  const { value: urdf } = useServiceQuery<string>(SERVICE, "model/urdf");
  return (
    <div className="vr">
      <p>
        <Link href={addresses.humanoid()}>{t("back")}</Link>
      </p>
      <h1>{t("title")}</h1>
      <p className="small quiet">{t("notSafe")}</p>
      {failure !== null && <ErrorMessage act={<Link href={addresses.services()}>{t("health:toSystem")}</Link>}>{failure}</ErrorMessage>}
      {model !== null && urdf !== null ? <PersonView model={model} urdf={urdf} /> : failure === null && <Loading />}
    </div>
  );
}

function PersonView({ model, urdf }: { model: HumanoidModel; urdf: string }) {
  const { t } = useTranslation(["humanoidVr", "humanoid", "system"]);
  const host = useRef<HTMLDivElement>(null);
  const view = useRef<VrView | null>(null);
  const [showing, setShowing] = useState<"loading" | "shown" | "noDescription" | "noWebgl">("loading");
  const [using, setUsing] = useState<Using>("nothing");
  const [headset, setHeadset] = useState<boolean | null>(null);
  const [posture, setPosture] = useState<Posture>("seated");
  const [application, setApplication] = useState<Application>("juggling");
  const [isMeasuring, setIsMeasuring] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const [panel, setPanel] = useState<PanelContent | null>(null);
  const [shown, setShown] = useState<Shown>({ document: null, figures: null });
  const chosen = useRef(application);

  useEffect(() => {
    let isGone = false;
    void hasHeadset().then((found) => {
      if (!isGone) setHeadset(found);
    });
    return () => {
      isGone = true;
    };
  }, []);

  useEffect(() => {
    const place = host.current;
    if (place === null) return;
    let isGone = false;
    queueMicrotask(() => {
      if (isGone) return;
      const start = () => {
        const kind = chosen.current;
        requestService(SERVICE, "sessions", { method: "POST", json: { application: kind, goal: GOALS[kind] } }).then(
          () => view.current?.fail(null),
          (error: unknown) => view.current?.fail(errorText(error)),
        );
      };
      try {
        view.current = new VrView(place, urdf, model, { onUsing: setUsing, onAct: start, onPanel: setPanel });
        setShowing("shown");
      } catch (error) {
        setShowing(error instanceof InvalidDescription ? "noDescription" : "noWebgl");
      }
    });
    return () => {
      isGone = true;
      view.current?.dispose();
      view.current = null;
    };
  }, [urdf, model]);

  useEffect(() => {
    const timer = setInterval(() => setShown({ document: view.current?.document ?? null, figures: view.current?.measuring.figures() ?? null }), SHOWN_EVERY_MS);
    return () => clearInterval(timer);
  }, []);

  useEffect(() => {
    chosen.current = application;
    if (view.current === null) return;
    view.current.posture = posture;
    view.current.isMeasuring = isMeasuring;
    view.current.measuring.clear();
  }, [posture, application, isMeasuring, showing]);

  const enter = () => {
    setFailure(null);
    view.current?.enterHeadset().catch((error: unknown) => setFailure(t("noEntry", { reason: error instanceof Error ? error.message : String(error) })));
  };
  return (
    <>
      <div className="vr__acts">
        <SegmentedControl label={t("exercise")} value={application} onChange={setApplication} options={(["juggling", "walking"] as const).map((value) => ({ value, name: t(`application.${value}`) }))} />
        <SegmentedControl label={t("posture")} value={posture} onChange={setPosture} options={(["seated", "standing"] as const).map((value) => ({ value, name: t(`postures.${value}`) }))} />
        {using === "nothing" ? (
          <>
            <Button kind="main" icon={<Glasses aria-hidden size={20} />} isDisabled={headset !== true || showing !== "shown" || !mayDo("performTasks")} onPress={enter}>
              {t("enter")}
            </Button>
            <Button icon={<MousePointer2 aria-hidden size={20} />} isDisabled={showing !== "shown" || !mayDo("performTasks")} onPress={() => view.current?.usePointer()}>
              {t("pointer")}
            </Button>
          </>
        ) : null}
      </div>
      {headset === false && <p className="small quiet">{t(window.isSecureContext ? "noHeadset" : "notSecure")}</p>}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <div
        ref={host}
        className="vr__stage"
        data-using={using}
        data-session={shown.document?.session?.state}
        {...(showing === "shown" ? { tabIndex: 0, role: "application", "aria-label": t("view") } : {})}
        onKeyDown={(event) => {
          if (event.ctrlKey || event.metaKey || event.altKey) return;
          if (view.current?.key(event.key) === true) event.preventDefault();
        }}
        onKeyUp={(event) => view.current?.keyUp(event.key)}
      >
        {showing !== "shown" && (
          <div className="vr__note">
            {showing === "loading" ? <p className="quiet">{t("system:robot.loading3d")}</p> : <EmptyState title={t(`system:robot.${showing}.title`)}>{t(`system:robot.${showing}.means`, { robot: model.name })}</EmptyState>}
          </div>
        )}
      </div>
      {using !== "nothing" && panel !== null && (
        <section className="vr__panel" aria-label={t("panel.shown")} data-warning={panel.isWarning || undefined}>
          <div role="status">
            <h2>{panel.title}</h2>
            {panel.lines.map((line) => (
              <p key={line}>{line}</p>
            ))}
          </div>
          <div className="vr__acts">
            {panel.buttons.map(({ id, label }) => (
              <Button key={id} size="large" onPress={() => view.current?.act(id as Act)}>
                {label}
              </Button>
            ))}
          </div>
        </section>
      )}
      <p className="small quiet">{t(using === "pointer" ? "pointerHelp" : "headsetHelp")}</p>
      <Card title={t("measured.title")}>
        <Checkbox isSelected={isMeasuring} onChange={setIsMeasuring}>
          {t("measured.act")}
        </Checkbox>
        {isMeasuring && shown.figures !== null && <Figures figures={shown.figures} />}
      </Card>
      <StopBar document={shown.document} />
    </>
  );
}

function Figures({ figures }: { figures: Record<Measured, Quantiles | null> }) {
  const { t, i18n } = useTranslation("humanoidVr");
  const ms = new Intl.NumberFormat(i18n.language, { minimumFractionDigits: 1, maximumFractionDigits: 1 });
  return (
    <>
      {figures.poseWorked !== null && (
        <p className="vr__aim">
          <StatusBadge tone={figures.poseWorked.median < AIM_MS ? "ok" : "attention"}>
            {t("measured.aim", { ms: ms.format(figures.poseWorked.median), goal: AIM_MS })}
          </StatusBadge>{" "}
          {figures.poseDrawn !== null && t("measured.whole", { ms: ms.format(figures.poseDrawn.median) })}
        </p>
      )}
      <table className="vr__table">
        <thead>
          <tr>
            <th scope="col">{t("measured.what")}</th>
            <th scope="col">{t("measured.median")}</th>
            <th scope="col">{t("measured.p99")}</th>
          </tr>
        </thead>
        <tbody>
          {MEASURED.map((name) => {
            const found = figures[name];
            return (
              <tr key={name} data-measured={name} data-median={found?.median} data-p99={found?.p99} data-count={found?.count}>
                <th scope="row">{t(`measured.${name}`)}</th>
                <td>{found === null ? "–" : ms.format(found.median)}</td>
                <td>{found === null ? "–" : ms.format(found.p99)}</td>
              </tr>
            );
          })}
        </tbody>
      </table>
    </>
  );
}
