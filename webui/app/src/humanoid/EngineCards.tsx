/** What engineers look at: the stack of tasks, the solver, the feet, the cycle, and the model by its chains. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Card } from "~/design/Card";
import { number } from "~/design/numbers";
import "~/design/Figures.css";
import { SIDES, type HumanoidModel, type LiveDocument } from "./humanoid";

const RAD = 180 / Math.PI;

/** Residuals that have been seen, as long as bars of their largest value. */
export function StackCard({ document }: { document: LiveDocument }) {
  const { t, i18n } = useTranslation("humanoid");
  const [largest, setLargest] = useState<Readonly<Record<string, number>>>({});
  const grown = document.stack.filter(({ task, residual }) => residual > (largest[task] ?? 0));
  if (grown.length > 0) setLargest({ ...largest, ...Object.fromEntries(grown.map(({ task, residual }) => [task, residual])) });
  const tasks = [...document.stack].sort((a, b) => a.level - b.level);
  return (
    <Card title={t("stack.title")}>
      {tasks.length === 0 ? (
        <p className="quiet">{t("stack.none")}</p>
      ) : (
        <table className="figures">
          <thead>
            <tr>
              <th scope="col">{t("stack.priority")}</th>
              <th scope="col">{t("stack.task")}</th>
              <th scope="col">{t("stack.residual")}</th>
              <th scope="col"><span className="visually-hidden">{t("stack.bar")}</span></th>
            </tr>
          </thead>
          <tbody>
            {tasks.map(({ level, task, residual }) => (
              <tr key={task}>
                <td>{level + 1}</td>
                <th scope="row">{task.split(" ").map((word) => t(`task.${word}`, { defaultValue: word })).join(" ")}</th>
                <td>{number(residual, i18n.language, { minimumFractionDigits: 3, maximumFractionDigits: 3 })}</td>
                <td className="humanoid__bar"><Bar share={residual / Math.max(largest[task] ?? 0, 1e-9)} /></td>
              </tr>
            ))}
          </tbody>
        </table>
      )}
      {(document.relaxed ?? []).map(({ constraint, slack }) => (
        <p key={constraint}>
          {t("stack.relaxed", { constraint, slack: number(slack, i18n.language, { maximumSignificantDigits: 2 }) })}
        </p>
      ))}
    </Card>
  );
}

export function SolverCard({ document: { solver, cycle } }: { document: LiveDocument }) {
  const { t, i18n } = useTranslation("humanoid");
  const most = Math.max(1, ...solver.histogram.map(([, count]) => count));
  const us = (value: number | null) => (value === null ? "–" : `≤ ${number(value, i18n.language)} µs`);
  return (
    <Card title={t("solver.title")}>
      <p>{t("solver.said", { median: us(solver.medianUs), p99: us(solver.p99Us) })}</p>
      {solver.histogram.length > 0 && (
        <svg className="humanoid-histogram" viewBox={`0 0 ${solver.histogram.length * 20} 100`} preserveAspectRatio="none" role="img" aria-label={t("solver.said", { median: us(solver.medianUs), p99: us(solver.p99Us) })}>
          {solver.histogram.map(([bound, count], index) => (
            <rect key={bound ?? "inf"} x={index * 20 + 1} width={18} y={100 - (96 * count) / most} height={(96 * count) / most} />
          ))}
        </svg>
      )}
      {solver.histogram.length > 0 && (
        <p className="humanoid-histogram__ends small quiet">
          <span>{us(solver.histogram[0]?.[0] ?? null)}</span>
          <span>{t("solver.above", { bound: number(solver.histogram.at(-2)?.[0] ?? 0, i18n.language) })}</span>
        </p>
      )}
      <p className="small quiet">
        {t("cycle.said", { count: number(cycle.count, i18n.language), late: number(cycle.late, i18n.language), lost: number(cycle.lost, i18n.language) })}
        {cycle.cause !== "" && ` ${t("cycle.cause", { cause: t(`cycle.causes.${cycle.cause}`, { defaultValue: cycle.cause }) })}`}
      </p>
    </Card>
  );
}

export function ForcesCard({ document, massKg }: { document: LiveDocument; massKg: number }) {
  const { t, i18n } = useTranslation("humanoid");
  const newtons = (value: number) => `${number(value, i18n.language, { maximumFractionDigits: 0 })} N`;
  return (
    <Card title={t("forces.title")}>
      <table className="figures">
        <thead>
          <tr>
            {(["foot", "up", "along", "share"] as const).map((name) => <th key={name} scope="col">{t(`forces.${name}`)}</th>)}
            <th scope="col"><span className="visually-hidden">{t("forces.share")}</span></th>
          </tr>
        </thead>
        <tbody>
          {SIDES.map((side) => {
            const { force, share } = document.feet[side];
            return (
              <tr key={side}>
                <th scope="row">{t(`side.${side}`)}</th>
                <td>{force === null ? "–" : newtons(force[2])}</td>
                <td>{force === null ? "–" : newtons(Math.hypot(force[0], force[1]))}</td>
                <td>{share === null ? "–" : number(share, i18n.language, { style: "percent", maximumFractionDigits: 0 })}</td>
                <td className="humanoid__bar"><Bar share={share ?? 0} /></td>
              </tr>
            );
          })}
        </tbody>
      </table>
      <p className="small quiet">{t("forces.weight", { weight: newtons(9.81 * massKg) })}</p>
    </Card>
  );
}

/** The chains of the model; an open one shows its joints with limits, gains and present angles. */
export function ModelCard({ document, model }: { document: LiveDocument; model: HumanoidModel }) {
  const { t, i18n } = useTranslation("humanoid");
  const degrees = (value: number) => `${number(value * RAD, i18n.language, { maximumFractionDigits: 1 })}°`;
  const figure = (value: number) => number(value, i18n.language, { maximumFractionDigits: 1 });
  const withUnit = (value: number, unit: string) => `${figure(value)} ${unit}`;
  return (
    <Card title={t("model.title", { model: model.name })} aside={<span className="quiet">{t("model.figures", { joints: model.joints.length, mass: figure(model.massKg) })}</span>}>
      {model.chains.map((chain) => (
        <details key={chain.name} className="humanoid-chain">
          <summary>
            {chain.name} <span className="small quiet">{t("model.chain", { count: chain.joints.length, base: chain.base, tip: chain.tip })}</span>
          </summary>
          <div className="humanoid__scroll">
            <table className="figures">
              <thead>
                <tr>
                  {(["joint", "angle", "range", "velocity", "effort", "stiffness", "damping"] as const).map((name) => <th key={name} scope="col">{t(`model.column.${name}`)}</th>)}
                </tr>
              </thead>
              <tbody>
                {chain.joints.map((joint) => {
                  const angle = document.joints[model.joints.indexOf(joint.name)] ?? null;
                  return (
                    <tr key={joint.name}>
                      <th scope="row">{joint.name}</th>
                      <td>{angle === null ? "–" : degrees(angle)}</td>
                      <td>{degrees(joint.lower)} … {degrees(joint.upper)}</td>
                      <td>{withUnit(joint.velocity, "rad/s")}</td>
                      <td>{withUnit(joint.effort, "N m")}</td>
                      <td>{withUnit(joint.gain, "N m/rad")}</td>
                      <td>{withUnit(joint.damping, "N m s/rad")}</td>
                    </tr>
                  );
                })}
              </tbody>
            </table>
          </div>
        </details>
      ))}
    </Card>
  );
}

function Bar({ share }: { share: number }) {
  return (
    <svg viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden>
      <rect width={100 * Math.min(Math.max(share, 0), 1)} height={8} />
    </svg>
  );
}
