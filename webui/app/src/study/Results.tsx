/** The results: SUS with its grade, and NASA-TLX with personal and with predefined gestures. */
import { useTranslation } from "react-i18next";
import { Card } from "~/design/Card";
import "~/design/Figures.css";
import { EmptyState } from "~/design/EmptyState";
import { number } from "~/design/numbers";
import { BoxPlot } from "./BoxPlot";
import { csvUrl, measures, pdfUrl, type Analysis } from "./study";

const columns = ["scale", "medianPersonal", "medianPredefined", "u", "p", "effect", "paired"] as const;

export function Results({ analysis }: { analysis: Analysis }) {
  const { t, i18n } = useTranslation("study");
  const files = (
    <span className="study__files">
      <a href={csvUrl} download="study.csv">
        {t("results.csv")}
      </a>
      <a href={pdfUrl(i18n.language)} download="study.pdf">
        {t("results.pdf")}
      </a>
    </span>
  );
  return (
    <Card title={t("results.title")} aside={files}>
      {analysis.sus.n === 0 ? <EmptyState title={t("results.none.title")}>{t("results.none.means")}</EmptyState> : <Found analysis={analysis} />}
    </Card>
  );
}

function Found({ analysis }: { analysis: Analysis }) {
  const { t, i18n } = useTranslation("study");
  const { sus, tlx, preference } = analysis;
  const figure = (value: number | null | undefined, digits = 2) =>
    value == null ? "–" : number(value, i18n.language, { maximumFractionDigits: digits, minimumFractionDigits: digits });
  const chance = (p: number | undefined) => (p === undefined ? "–" : p < 0.001 ? `< ${figure(0.001, 3)}` : figure(p, 3));
  const inWords = (p: number) => (p < 0.001 ? chance(p) : `= ${chance(p)}`);
  const rows = measures.flatMap((measure) => {
    const compared = tlx[measure];
    return compared === undefined ? [] : [{ measure, ...compared }];
  });
  return (
    <>
      <p className="quiet">
        {t("results.participants", {
          participants: analysis.participants,
          finished: analysis.finished,
          personal: analysis.personalFirst,
          predefined: analysis.predefinedFirst,
        })}
      </p>
      <h3>{t("results.sus")}</h3>
      <p>
        <strong className="study__grade">{sus.grade}</strong>
        {t("results.susIs", { mean: figure(sus.mean), sd: figure(sus.sd), n: sus.n })}{" "}
        {sus.test.p === undefined
          ? t("results.tooFew")
          : t("results.susTest", { t: figure(sus.test.t), df: sus.test.df, p: inWords(sus.test.p) })}
      </p>
      <BoxPlot label={t("results.susPlot")} rows={[{ name: "SUS", parts: [{ tone: "accent", summary: sus }] }]} line={68} />
      <h3>{t("results.tlx")}</h3>
      <p className="study__legend">
        <span data-tone="accent">{t("results.personal")}</span>
        <span data-tone="attention">{t("results.predefined")}</span>
      </p>
      <BoxPlot
        label={t("results.tlxPlot")}
        rows={rows.map(({ measure, personal, predefined }) => ({
          name: t(`measure.${measure}`),
          parts: [
            { tone: "accent", summary: personal },
            { tone: "attention", summary: predefined },
          ],
        }))}
      />
      <div className="study__scroll" role="region" tabIndex={0} aria-label={t("results.tlx")}>
        <table className="figures study__table">
          <thead>
            <tr>
              {columns.map((column) => (
                <th key={column} scope="col">
                  {t(`results.${column}`)}
                </th>
              ))}
            </tr>
          </thead>
          <tbody>
            {rows.map(({ measure, personal, predefined, test, paired }) => (
              <tr key={measure}>
                <th scope="row">{t(`measure.${measure}`)}</th>
                <td>{figure(personal.box?.median, 1)}</td>
                <td>{figure(predefined.box?.median, 1)}</td>
                <td>{figure(test.u, 1)}</td>
                <td>{chance(test.p)}</td>
                <td>{figure(test.effect)}</td>
                <td>{chance(paired.p)}</td>
              </tr>
            ))}
          </tbody>
        </table>
      </div>
      <p className="quiet">{t("results.method")}</p>
      <h3>{t("results.preference")}</h3>
      <p>{t("results.preferred", { ...preference })}</p>
    </>
  );
}
