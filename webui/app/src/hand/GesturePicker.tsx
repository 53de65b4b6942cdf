/**
* A choice of one gesture: a button with the chosen hand, and a panel with the pictures of all, which can be
 * searched. Its tiles are large enough for a finger in a glove.
 */
import { ArrowRight, ChevronDown, Search } from "lucide-react";
import { Fragment, useId, useState } from "react";
import { Button as AriaButton, Dialog, Heading, Input, Label, ListBox, ListBoxItem, Modal, ModalOverlay, SearchField } from "react-aria-components";
import { useTranslation } from "react-i18next";
import "~/design/ConfirmDialog.css";
import { Button } from "~/design/Button";
import { mayDo, type Permission } from "~/session/session";
import { Hand, useGestureName } from "./Hand";
import "./GesturePicker.css";

/** An option; `hands` are its hand shapes, empty for "no gesture". */
export interface GestureOption {
  value: string;
  hands: readonly { code: string; side: "left" | "right" }[];
  /** The hands are shown one after the other. */
  inTurn?: boolean;
  /** The label, if it is not the name of the gesture. */
  name?: string;
}

export interface GesturePickerProps {
  label: string;
  value: string;
  options: readonly GestureOption[];
  onChange: (value: string) => void;
  /** What a choice needs; users without it see the present one. */
  permission?: Permission;
}

export function GesturePicker({ label, value, options, onChange, permission }: GesturePickerProps) {
  const { t, i18n } = useTranslation("hand");
  const gestureName = useGestureName();
  const id = useId();
  const [isOpen, setOpen] = useState(false);
  const [search, setSearch] = useState("");
  const nameOf = (option: GestureOption) => option.name ?? gestureName(option.value);
  const chosen = options.find((option) => option.value === value);
  const plain = (text: string) => text.toLocaleLowerCase(i18n.language);
  const words = plain(search).split(/\s+/).filter((word) => word !== "");
  const found = options.filter((option) => words.every((word) => plain(`${nameOf(option)} ${option.value}`).includes(word)));
  const open = (next: boolean) => {
    setOpen(next);
    setSearch("");
  };
  const choose = (next: string) => {
    open(false);
    if (next !== value) onChange(next);
  };
  return (
    <div className="gesture-picker">
      <span id={`${id}-label`} className="gesture-picker__label">
        {label}
      </span>
      <AriaButton className="gesture-picker__button" id={id} aria-labelledby={`${id}-label ${id}-value`} aria-haspopup="dialog" isDisabled={permission !== undefined && !mayDo(permission)} onPress={() => open(true)}>
        {chosen !== undefined && <Hands option={chosen} size="56px" />}
        <span id={`${id}-value`}>{chosen === undefined ? "–" : nameOf(chosen)}</span>
        <ChevronDown aria-hidden size={18} />
      </AriaButton>
      <ModalOverlay className="confirm-dialog__overlay" isOpen={isOpen} onOpenChange={open} isDismissable>
        <Modal className="confirm-dialog gesture-picker__panel">
          <Dialog className="confirm-dialog__dialog gesture-picker__dialog">
            <Heading slot="title" className="confirm-dialog__title">
              {label}
            </Heading>
            <SearchField className="gesture-picker__search" value={search} onChange={setSearch} autoFocus>
              <Label className="visually-hidden">{t("picker.search")}</Label>
              <Search aria-hidden size={20} />
              <Input placeholder={t("picker.search")} onKeyDown={(event) => {
                const [only] = found;
                if (event.key === "Enter" && only !== undefined && found.length === 1) choose(only.value);
              }} />
            </SearchField>
            <ListBox
              className="gesture-picker__tiles"
              aria-label={label}
              layout="grid"
              selectionMode="single"
              selectedKeys={[keyOf(value)]}
              items={found.map((option) => ({ id: keyOf(option.value), option }))}
              renderEmptyState={() => <p className="quiet">{t("picker.none")}</p>}
              onSelectionChange={(keys) => {
                // Choosing the chosen option again would deselect it: keep it.
                const [key] = keys === "all" ? [] : keys;
                choose(valueOf(String(key ?? keyOf(value))));
              }}
            >
              {({ option }) => (
                <ListBoxItem className="gesture-picker__tile" textValue={nameOf(option)}>
                  <Hands option={option} size="96px" />
                  <span>{nameOf(option)}</span>
                </ListBoxItem>
              )}
            </ListBox>
            <div className="confirm-dialog__actions">
              <Button onPress={() => open(false)}>{t("picker.cancel")}</Button>
            </div>
          </Dialog>
        </Modal>
      </ModalOverlay>
    </div>
  );
}

/** Keys must not be empty; the value of "no gesture" is. */
const keyOf = (value: string) => `=${value}`;
const valueOf = (key: string) => key.slice(1);

function Hands({ option, size }: { option: GestureOption; size: string }) {
  return (
    <span className="gesture-picker__hands" aria-hidden>
      {option.hands.map(({ code, side }, index) => (
        <Fragment key={index}>
          {option.inTurn === true && index > 0 && <ArrowRight size={18} />}
          <Hand states={code} side={side} size={size} />
        </Fragment>
      ))}
    </span>
  );
}
