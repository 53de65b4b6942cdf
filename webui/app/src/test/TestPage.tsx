/** The Test page: what the glove makes of the hand, and how sure and quick that is. No Task is touched. */
import { Hand as HandIcon } from "lucide-react";
import { useTranslation } from "react-i18next";
import { useLocation } from "wouter";
import { Button } from "~/design/Button";
import { Choice } from "~/design/Choice";
import { Empty } from "~/design/Empty";
import { Pick } from "~/design/Pick";
import { State } from "~/design/State";
import { usePick } from "~/live/hooks";
import { useGloveNames } from "~/live/names";
import { useQuery } from "~/route/query";
import { useKeys } from "~/shell/keys";
import { Accuracy } from "./Accuracy";
import { FreeTrial } from "./FreeTrial";
import "./TestPage.css";

const parts = ["try", "accuracy"] as const;
type Part = (typeof parts)[number];

export default function TestPage() {
  const { t } = useTranslation("test");
  const [, go] = useLocation();
  const gloves = useGloveNames();
  const [askedGlove, setGlove] = useQuery("glove");
  const [askedPart, setPart] = useQuery("part", "try");
  const glove = gloves.find((one) => one === askedGlove) ?? gloves[0];
  const part: Part = parts.find((one) => one === askedPart) ?? "try";
  useKeys(parts.map((one) => ({ key: one.charAt(0), does: t(`part.${one}`), act: () => setPart(one) })));
  return (
    <div className="test">
      <header className="test__head">
        <h1>{t("title")}</h1>
        {glove !== undefined && (
          <>
            <Pick label={t("glove")} value={glove} options={gloves.map((one) => ({ value: one, name: one }))} onChange={setGlove} />
            <Choice<Part> label={t("title")} value={part} options={parts.map((one) => ({ value: one, name: t(`part.${one}`) }))} onChange={setPart} />
            <Link glove={glove} />
          </>
        )}
      </header>
      {glove === undefined ? (
        <Empty
          icon={<HandIcon aria-hidden size={32} />}
          title={t("none.title")}
          act={
            <Button kind="main" onPress={() => go("/")}>
              {t("none.act")}
            </Button>
          }
        >
          {t("none.means")}
        </Empty>
      ) : part === "try" ? (
        <FreeTrial key={glove} glove={glove} />
      ) : (
        <Accuracy key={glove} glove={glove} />
      )}
    </div>
  );
}

function Link({ glove }: { glove: string }) {
  const { t } = useTranslation("test");
  const isConnected = usePick(`glove/${glove}`, (view) => view?.connected) === true;
  return <p className="test__link">{isConnected ? <State tone="ok">{t("connected")}</State> : <State tone="attention">{t("away")}</State>}</p>;
}
