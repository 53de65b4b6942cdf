/** A new gesture: by its finger states, by recording, for both hands, or as a sequence of two. */
import { Hand as HandIcon } from "lucide-react";
import { Fragment, useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { fingers } from "~/hand/geometry";
import { GesturePicker } from "~/hand/GesturePicker";
import { Hand, useGestureName } from "~/hand/Hand";
import { define, type Nearest, type PersonInFull, type Recording } from "./people";

const ways = ["fingers", "make", "hands", "turn"] as const;
type Way = (typeof ways)[number];

/** The duration of a recording: long enough to see whether the hand is still. */
const RECORD_MS = 1500;
const FIST = "22222";

export function NewGesture({ person, onDefined }: { person: PersonInFull; onDefined: () => void }) {
  const { t } = useTranslation("people");
  const gestureName = useGestureName();
  const [way, setWay] = useState<Way>("fingers");
  const [name, setName] = useState("");
  const [code, setCode] = useState(FIST);
  const [pair, setPair] = useState<[string, string]>(["", ""]);
  const [glove, setGlove] = useState("");
  const [isBusy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const [made, setMade] = useState<{ name: string; nearest: Nearest | null } | null>(null);

  const plain = person.gestures.filter((gesture) => "code" in gesture);
  const worn = person.gloves.find((each) => each.glove === glove) ?? person.gloves[0];
  const [first, second] = [pair[0] || (plain[0]?.name ?? ""), pair[1] || (plain[1]?.name ?? "")];
  const how = (): Recording | null => {
    switch (way) {
      case "fingers":
        return { code };
      case "make":
        return worn === undefined ? null : { glove: worn.glove, recordMs: RECORD_MS };
      case "hands":
        return { left: first, right: second };
      case "turn":
        return { sequence: [first, second] };
    }
  };
  const save = async () => {
    const recording = how();
    if (recording === null) return;
    setBusy(true);
    setFailure(null);
    setMade(null);
    try {
      const { nearest } = await define(person.name, name.trim(), recording);
      setMade({ name: name.trim(), nearest });
      setName("");
      onDefined();
    } catch (error) {
      setFailure(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  const options = (side: "left" | "right") => plain.map((gesture) => ({ value: gesture.name, hands: [{ code: gesture.code, side }] }));

  return (
    <section className="new-gesture" aria-label={t("new.title")}>
      <h3>{t("new.title")}</h3>
      <SegmentedControl label={t("new.way")} value={way} options={ways.map((way) => ({ value: way, name: t(`new.ways.${way}`) }))} onChange={setWay} />
      <Field label={t("new.name")} value={name} onChange={setName} />
      {way === "fingers" && (
        <div className="new-gesture__fingers">
          <Hand states={code} size="140px" moveMs={160} />
          <div className="new-gesture__states">
            {fingers.map((finger, index) => (
              <Fragment key={finger}>
                <span aria-hidden>{t(`hand:finger.${finger}`)}</span>
                <SegmentedControl
                  label={t(`hand:finger.${finger}`)}
                  value={code[index] ?? "2"}
                  options={[
                    { value: "0", name: t("new.straight") },
                    { value: "2", name: t("new.bent") },
                  ]}
                  onChange={(state) => setCode(code.slice(0, index) + state + code.slice(index + 1))}
                />
              </Fragment>
            ))}
          </div>
        </div>
      )}
      {way === "make" &&
        (worn === undefined ? (
          <p>{t("new.noGlove")}</p>
        ) : (
          <>
            {person.gloves.length > 1 && (
              <Select label={t("new.glove")} value={worn.glove} options={person.gloves.map((glove) => ({ value: glove.glove, name: glove.glove }))} onChange={setGlove} />
            )}
            <p className="quiet">{t("new.makeMeans")}</p>
          </>
        ))}
      {(way === "hands" || way === "turn") && (
        <div className="new-gesture__pair">
          <GesturePicker label={t(way === "hands" ? "new.left" : "new.first")} value={first} options={options(way === "hands" ? "left" : "right")} onChange={(name) => setPair([name, second])} />
          <GesturePicker label={t(way === "hands" ? "new.right" : "new.second")} value={second} options={options("right")} onChange={(name) => setPair([first, name])} />
        </div>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <div className="new-gesture__actions">
        <Button permission="configure"
          kind="main"
          icon={way === "make" ? <HandIcon aria-hidden size={18} /> : undefined}
          isDisabled={isBusy || name.trim() === "" || how() === null}
          onPress={() => void save()}
        >
          {t(way === "make" ? (isBusy ? "new.recording" : "new.record") : "new.save")}
        </Button>
        <p role="status">
          {made !== null && (
            <StatusBadge tone="ok">
              {made.nearest === null
                ? t("new.made", { gesture: made.name })
                : t("new.madeNear", { gesture: made.name, other: gestureName(made.nearest.gesture), count: made.nearest.distance })}
            </StatusBadge>
          )}
        </p>
      </div>
    </section>
  );
}
