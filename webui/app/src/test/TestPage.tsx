/** The Test page: live recognition and accuracy tests. It does not affect Tasks. */
import { useTranslation } from "react-i18next";
import { SegmentedControl } from "~/design/SegmentedControl";
import { StatusBadge } from "~/design/StatusBadge";
import { GloveSelect, NoGlove, useSelectedGlove } from "~/glove/GloveSelect";
import { useTopicSelector } from "~/live/hooks";
import { useChoice } from "~/route/choice";
import { Accuracy } from "./Accuracy";
import { FreeTrial } from "./FreeTrial";
import "./TestPage.css";

const parts = ["try", "accuracy"] as const;
type Part = (typeof parts)[number];

export default function TestPage() {
  // Load `hand` with the page: a panel that loads it later would suspend the page and lose the focus.
  const { t } = useTranslation(["test", "hand"]);
  const glove = useSelectedGlove();
  const [part, setPart] = useChoice<Part>("part", parts, "try");
  return (
    <div className="test">
      <header className="test__head">
        <h1>{t("title")}</h1>
        {glove !== undefined && (
          <>
            <GloveSelect glove={glove} />
            <SegmentedControl<Part> label={t("title")} value={part} options={parts.map((part) => ({ value: part, name: t(`part.${part}`) }))} onChange={setPart} />
            <Link glove={glove} />
          </>
        )}
      </header>
      {glove === undefined ? (
        <NoGlove means={t("none")} />
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
  const isConnected = useTopicSelector(`glove/${glove}`, (view) => view?.connected) === true;
  return <p className="test__link">{isConnected ? <StatusBadge tone="ok">{t("connected")}</StatusBadge> : <StatusBadge tone="attention">{t("away")}</StatusBadge>}</p>;
}
