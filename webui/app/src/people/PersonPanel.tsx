/** A person: their gloves, the gesture of each command, their own gestures, and import and export of the profile. */
import { Download, FileUp, RotateCcw, Trash2 } from "lucide-react";
import { useState } from "react";
import { FileTrigger } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { download } from "~/api/download";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { Select } from "~/design/Select";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { GesturePicker } from "~/hand/GesturePicker";
import { useGestureName } from "~/hand/Hand";
import { useGloveNames } from "~/live/names";
import { MayNot } from "~/design/MayNot";
import { GesturePicture } from "./GesturePicture";
import { NewGesture } from "./NewGesture";
import {
  dropGesture, exchanged, giveCommands, partsOf, profileOf, removePerson, SERVICE, takeCommandBack, takeProfile, wear,
  type Gesture, type Person, type PersonInFull,
} from "./people";

const NONE = "";

interface PersonPanelProps {
  name: string;
  people: readonly Person[];
  revision: string;
  onChange: () => void;
  onRemoved: () => void;
}

export function PersonPanel({ name, people, revision, onChange, onRemoved }: PersonPanelProps) {
  const { t } = useTranslation("people");
  const loaded = useServiceQuery<PersonInFull>(SERVICE, `people/${encodeURIComponent(name)}`, { revision });
  const [failure, setFailure] = useState<string | null>(null);
  const person = loaded.value;
  if (person === null) return loaded.failure === null ? null : <ErrorMessage>{loaded.failure}</ErrorMessage>;
  const act = async (action: Promise<unknown>) => {
    setFailure(null);
    try {
      await action;
    } catch (error) {
      setFailure(errorText(error));
    }
    onChange();
  };
  return (
    <>
      <header className="people__head">
        <h2>{person.title ?? person.name}</h2>
        {person.title !== null && <span className="quiet">{person.name}</span>}
        <Profile person={person} act={act} onRemoved={onRemoved} />
      </header>
      <MayNot permission="configure" />
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {person.faults.map((fault) => (
        <StatusBadge key={fault} tone="attention">
          {fault}
        </StatusBadge>
      ))}
      <Card title={t("gloves.title")}>
        <Gloves person={person} people={people} act={act} />
      </Card>
      <Card title={t("commands.title")}>
        <p className="quiet">{t("commands.means")}</p>
        <Commands person={person} act={act} />
      </Card>
      <Card title={t("own.title")}>
        <p className="quiet">{t("own.means")}</p>
        <OwnGestures person={person} act={act} />
        <NewGesture person={person} onDefined={onChange} />
      </Card>
    </>
  );
}

type Act = (action: Promise<unknown>) => Promise<void>;

/** The wearer of each glove; a glove can be assigned to this person or released. */
function Gloves({ person, people, act }: { person: Person; people: readonly Person[]; act: Act }) {
  const { t } = useTranslation("people");
  const gloves = useGloveNames();
  if (gloves.length === 0) return <p className="quiet">{t("gloves.none")}</p>;
  return (
    <div className="people__gloves">
      {gloves.map((glove) => {
        const wearer = people.find((each) => each.gloves.some((worn) => worn.glove === glove));
        const offered = wearer === undefined || wearer.name === person.name ? [person] : [wearer, person];
        return (
          <Select
            key={glove}
            label={t("gloves.wears", { glove })}
            value={wearer?.name ?? NONE}
            options={[{ value: NONE, name: t("gloves.nobody") }, ...offered.map((each) => ({ value: each.name, name: each.title ?? each.name }))]}
            onChange={(name) => void act(wear(glove, name === NONE ? null : name))}
          />
        );
      })}
    </div>
  );
}

function Commands({ person, act }: { person: PersonInFull; act: Act }) {
  const { t } = useTranslation("people");
  const options = [{ value: NONE, name: t("commands.without"), hands: [] }, ...person.gestures.map((gesture) => ({ value: gesture.name, hands: partsOf(gesture), inTurn: "sequence" in gesture }))];
  const numbers = [...new Set([...Object.keys(person.commands), ...Object.keys(person.ownCommands)])].sort((a, b) => Number(a) - Number(b));
  return (
    <ul className="people__commands">
      {numbers.map((command) => {
        const gesture = person.commands[command];
        const isOwn = command in person.ownCommands;
        return (
          <li key={command} data-own={isOwn || undefined}>
            <GesturePicker
              permission="configure"
              label={t("commands.command", { command })}
              value={gesture ?? NONE}
              options={options}
              onChange={(chosen) => void act(giveCommands(person.name, exchanged(person, command, chosen === NONE ? null : chosen)))}
            />
            {isOwn && (
              <Button permission="configure"
                kind="quiet"
                label={t("commands.asSite", { command })}
                icon={<RotateCcw aria-hidden size={16} />}
                onPress={() => void act(takeCommandBack(person.name, command))}
              />
            )}
          </li>
        );
      })}
    </ul>
  );
}

function OwnGestures({ person, act }: { person: PersonInFull; act: Act }) {
  const { t } = useTranslation("people");
  const gestureName = useGestureName();
  const own = person.gestures.filter((gesture): gesture is Gesture => gesture.name in person.ownGestures);
  if (own.length === 0) return <p className="quiet">{t("own.none")}</p>;
  return (
    <ul className="people__own">
      {own.map((gesture) => (
        <li key={gesture.name}>
          <GesturePicture gesture={gesture} size="88px" />
          <strong>{gestureName(gesture.name)}</strong>
          <Button permission="configure"
            kind="quiet"
            label={t("own.delete", { gesture: gesture.name })}
            icon={<Trash2 aria-hidden size={16} />}
            onPress={() => void act(dropGesture(person.name, gesture.name))}
          />
        </li>
      ))}
    </ul>
  );
}

function Profile({ person, act, onRemoved }: { person: PersonInFull; act: Act; onRemoved: () => void }) {
  const { t } = useTranslation("people");
  const [isAsking, setAsking] = useState(false);
  const save = async () => download(`${person.name}.yaml`, "application/yaml", await profileOf(person.name));
  return (
    <span className="people__profile">
      <Button icon={<Download aria-hidden size={18} />} onPress={() => void act(save())}>
        {t("profile.save")}
      </Button>
      <FileTrigger
        acceptedFileTypes={[".yaml", ".yml"]}
        onSelect={(files) => {
          const [first] = files ?? [];
          if (first !== undefined) void act(first.text().then((yaml) => takeProfile(person.name, yaml)));
        }}
      >
        <Button permission="configure" icon={<FileUp aria-hidden size={18} />}>{t("profile.load")}</Button>
      </FileTrigger>
      <Button permission="managePeople" kind="quiet" icon={<Trash2 aria-hidden size={18} />} onPress={() => setAsking(true)}>
        {t("forget.open")}
      </Button>
      <ConfirmDialog
        isOpen={isAsking}
        onClose={() => setAsking(false)}
        kind="stop"
        title={t("forget.title", { person: person.title ?? person.name })}
        act={t("forget.act")}
        onAct={async () => {
          await removePerson(person.name);
          onRemoved();
        }}
      >
        <p>{t("forget.means")}</p>
      </ConfirmDialog>
    </span>
  );
}
