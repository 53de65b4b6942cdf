/** The test of a glove: live recognition and accuracy tests. It does not affect Tasks. */
import { useTranslation } from "react-i18next";
import { SegmentedControl } from "~/design/SegmentedControl";
import { StatusBadge } from "~/design/StatusBadge";
import { useTopicSelector } from "~/live/hooks";
import { useChoice } from "~/route/choice";
import { Accuracy } from "./Accuracy";
import { FreeTrial } from "./FreeTrial";
import "./GloveTest.css";

const parts = ["try", "accuracy"] as const;
type Part = (typeof parts)[number];

export default function GloveTest({ glove }: { glove: string }) {
  const { t } = useTranslation("test");
  const [part, setPart] = useChoice<Part>("part", parts, "try");
  return (
    <div className="test">
      <div className="test__head">
        <SegmentedControl<Part> label={t("title")} value={part} options={parts.map((part) => ({ value: part, name: t(`part.${part}`) }))} onChange={setPart} />
        <Link glove={glove} />
      </div>
      {part === "try" ? <FreeTrial glove={glove} /> : <Accuracy glove={glove} />}
    </div>
  );
}

function Link({ glove }: { glove: string }) {
  const { t } = useTranslation("test");
  const isConnected = useTopicSelector(`glove/${glove}`, (view) => view?.connected) === true;
  return <p className="test__link">{isConnected ? <StatusBadge tone="ok">{t("connected")}</StatusBadge> : <StatusBadge tone="attention">{t("away")}</StatusBadge>}</p>;
}
