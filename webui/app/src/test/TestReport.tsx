/** The report of a test: Table 3 of the paper, the confusion matrix and the times. */
import { useTranslation } from "react-i18next";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Card } from "~/design/Card";
import { EmptyState } from "~/design/EmptyState";
import "~/design/Figures.css";
import { number, percent } from "~/design/numbers";
import { ErrorMessage } from "~/design/ErrorMessage";
import { useGestureName } from "~/hand/Hand";
import { columnsOf } from "./matrix";
import { fileUrl, reportPath, type Figures, type Report } from "./tests";

export function TestReport({ test }: { test: string }) {
  const { t } = useTranslation("test");
  const { value: report, failure } = useServiceQuery<Report>("gesture-controller", reportPath(test));
  if (failure !== null) return <ErrorMessage>{failure}</ErrorMessage>;
  if (report === null) return null;
  const files = (["csv", "json"] as const).map((kind) => (
    <a key={kind} className="test__file" href={fileUrl(test, kind)} download={`accuracy-${test.slice(0, 8)}.${kind}`}>
      {t(`report.${kind}`)}
    </a>
  ));
  return (
    <Card title={t("report.title")} aside={<span className="test__files">{files}</span>} className="test__report">
      {report.overall.trials === 0 ? <EmptyState title={t("report.none")} /> : <Found report={report} />}
    </Card>
  );
}

function Found({ report }: { report: Report }) {
  const { t, i18n } = useTranslation("test");
  const nameOf = useGestureName();
  const { overall, table } = report;
  return (
    <>
      <dl className="test__key">
        <Key name={t("report.accuracy")} value={rate(overall.accuracy, i18n.language, 2)} more={interval(overall, i18n.language)} />
        <Key name={t("report.median")} value={seconds(overall.medianMs, i18n.language)} more={t("report.p95", { value: seconds(overall.p95Ms, i18n.language) })} />
        <Key name={t("report.successful")} value={number(table.successfulInteractions, i18n.language)} more={t("report.of", { count: overall.trials })} />
        <Key name={t("report.problematic")} value={number(table.problematicInteractions, i18n.language)} more={t("report.missed", { count: overall.missed })} />
      </dl>
      <h3>{t("report.gestures")}</h3>
      <div className="test__scroll" role="region" tabIndex={0} aria-label={t("report.gestures")}>
        <table className="figures test__table">
          <thead>
            <tr>
              {(["gesture", "right", "corrected", "missedHead", "accuracy", "interval", "median", "p95head"] as const).map((column) => (
                <th key={column} scope="col">
                  {t(`report.${column}`)}
                </th>
              ))}
            </tr>
          </thead>
          <tbody>
            {report.gestures.map((row) => (
              <tr key={row.gesture} data-problem={(row.accuracy ?? 1) < 1 || undefined}>
                <th scope="row">{nameOf(row.gesture)}</th>
                <td>{row.right}</td>
                <td>{row.corrected}</td>
                <td>{row.missed}</td>
                <td>{rate(row.accuracy, i18n.language, 0)}</td>
                <td className="test__interval">{interval(row, i18n.language)}</td>
                <td>{seconds(row.medianMs, i18n.language)}</td>
                <td>{seconds(row.p95Ms, i18n.language)}</td>
              </tr>
            ))}
          </tbody>
        </table>
      </div>
      <h3>{t("report.confusion")}</h3>
      <p className="quiet">{t("report.confusionMeans")}</p>
      <Matrix report={report} />
    </>
  );
}

function Key({ name, value, more }: { name: string; value: string; more: string }) {
  return (
    <div>
      <dt>{name}</dt>
      <dd>
        <strong>{value}</strong>
        <span className="quiet">{more}</span>
      </dd>
    </div>
  );
}

function Matrix({ report }: { report: Report }) {
  const { t } = useTranslation("test");
  const nameOf = useGestureName();
  const { asked, recognized, counts } = report.confusion;
  const nameOfColumn = (name: string) => (name === "no gesture" ? t("report.noGesture") : name === "nothing kept" ? t("report.nothing") : nameOf(name));
  const columns = columnsOf(report.confusion);
  return (
    <div className="test__scroll" role="region" tabIndex={0} aria-label={t("report.confusion")}>
      <table className="matrix">
        <thead>
          <tr>
            <td />
            {columns.map((column) => (
              <th key={column} scope="col">
                <span>{nameOfColumn(recognized[column] ?? "")}</span>
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {asked.map((gesture, row) => {
            const total = (counts[row] ?? []).reduce((sum, count) => sum + count, 0);
            return (
              <tr key={gesture}>
                <th scope="row">{nameOf(gesture)}</th>
                {columns.map((column) => {
                  const count = counts[row]?.[column] ?? 0;
                  const share = total === 0 ? 0 : count / total;
                  const tone = recognized[column] === gesture ? "ok" : "stop";
                  return (
                    <td key={column} style={count === 0 ? undefined : { background: `color-mix(in srgb, var(--${tone}) ${Math.round(12 + share * 30)}%, var(--surface))` }}>
                      {count === 0 ? "" : count}
                    </td>
                  );
                })}
              </tr>
            );
          })}
        </tbody>
      </table>
    </div>
  );
}

function rate(share: number | null, language: string, digits: number): string {
  return share === null ? "–" : percent(share, language, digits);
}

function interval(figures: Figures, language: string): string {
  if (figures.interval === null) return "–";
  const [low, high] = figures.interval;
  return `${percent(low, language, 1)} – ${percent(high, language, 1)}`;
}

function seconds(ms: number | null, language: string): string {
  if (ms === null) return "–";
  return `${number(ms / 1000, language)} s`;
}
