/**
* The NASA-TLX questionnaire: six scales without an initial mark or a filled track that would suggest a
* value, then a choice in each of fifteen pairs.
 */
import { useState, type CSSProperties } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import type { StepProps } from "./Participant";

export function TlxForm(props: StepProps) {
  const [ratings, setRatings] = useState<Record<string, number>>({});
  const [isRated, setRated] = useState(false);
  if (isRated) return <Pairs {...props} ratings={ratings} back={() => setRated(false)} />;
  const rate = (scale: string, value: number) => setRatings((before) => ({ ...before, [scale]: value }));
  return <Ratings {...props} ratings={ratings} rate={rate} done={() => setRated(true)} />;
}

interface RatingsProps extends StepProps {
  ratings: Record<string, number>;
  rate: (scale: string, value: number) => void;
  done: () => void;
}

function Ratings({ words, session, ratings, rate, done }: RatingsProps) {
  const { t } = useTranslation("study", { lng: session.language });
  const { tlx, scales, scaleStep } = words;
  const open = scales.filter((scale) => ratings[scale] === undefined).length;
  return (
    <>
      <h1>{tlx.title}</h1>
      <p className="participant__text">{tlx.ask}</p>
      <ol className="scales">
        {scales.map((scale) => {
          const of = tlx.scales[scale];
          const rating = ratings[scale];
          if (of === undefined) return null;
          const mark = (value: string) => rate(scale, Number(value));
          return (
            <li key={scale} data-marked={rating !== undefined || undefined}>
              <label htmlFor={`tlx-${scale}`}>
                <strong>{of.title}</strong> {of.ask}
              </label>
              <input
                id={`tlx-${scale}`}
                type="range"
                min={0}
                max={100}
                step={scaleStep}
                value={rating ?? 50}
                style={{ "--rated": rating === undefined ? "0%" : `${rating}%` } as CSSProperties}
                aria-valuetext={rating === undefined ? t("unmarked") : `${rating}, ${of.low} – ${of.high}`}
                onChange={(event) => mark(event.target.value)}
                onPointerUp={(event) => mark(event.currentTarget.value)}
                onKeyUp={(event) => {
                  if (event.key === " " || event.key === "Enter") mark(event.currentTarget.value);
                }}
              />
              <div className="scales__ends" aria-hidden>
                <span>{of.low}</span>
                <span className="scales__value">{rating ?? t("unmarked")}</span>
                <span>{of.high}</span>
              </div>
            </li>
          );
        })}
      </ol>
      <div className="participant__actions">
        <Button kind="main" size="large" isDisabled={open > 0} onPress={done}>
          {t("next")}
        </Button>
        {open > 0 && <p role="status">{t("open", { count: open })}</p>}
      </div>
      <p className="participant__source">{t("source", { source: tlx.source })}</p>
    </>
  );
}

interface PairsProps extends StepProps {
  ratings: Record<string, number>;
  back: () => void;
}

function Pairs({ words, session, answer, busy, ratings, back }: PairsProps) {
  const { t } = useTranslation("study", { lng: session.language });
  const pairs = session.pairs ?? [];
  const [chosen, setChosen] = useState<readonly string[]>([]);
  const pair = pairs[chosen.length];
  const send = (all: readonly string[]) => answer({ ratings, choices: pairs.map((of, index) => ({ of, chosen: all[index] })) });
  const choose = (scale: string) => {
    const all = [...chosen, scale];
    setChosen(all);
    if (all.length === pairs.length) send(all);
  };
  const again = () => (chosen.length > 0 ? setChosen(chosen.slice(0, -1)) : back());
  return (
    <>
      <h1>{words.tlx.choose}</h1>
      <p className="participant__text">{t("pair", { index: Math.min(chosen.length + 1, pairs.length), of: pairs.length })}</p>
      {pair !== undefined && (
        <div className="pair" key={pair.join(" ")}>
          {pair.map((scale) => (
            <button type="button" key={scale} onClick={() => choose(scale)}>
              <strong>{words.tlx.scales[scale]?.title}</strong>
              <span>{words.tlx.scales[scale]?.ask}</span>
            </button>
          ))}
        </div>
      )}
      <div className="participant__actions">
        {pair === undefined && (
          <Button kind="main" size="large" isDisabled={busy} onPress={() => send(chosen)}>
            {t("send")}
          </Button>
        )}
        <Button size="large" isDisabled={busy} onPress={again}>
          {t("back")}
        </Button>
      </div>
    </>
  );
}
