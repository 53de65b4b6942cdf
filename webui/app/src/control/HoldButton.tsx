/** A button that acts while it is held, with a pointer or with the keyboard, and not a moment longer. */
import { useEffect, useRef, type ReactNode } from "react";

export interface HoldButtonProps {
  className?: string;
  label?: string;
  isDisabled?: boolean;
  onHold: (isHeld: boolean) => void;
  children: ReactNode;
}

export function HoldButton({ className = "", label, isDisabled = false, onHold, children }: HoldButtonProps) {
  const isHeld = useRef(false);
  const set = (held: boolean) => {
    if (isHeld.current === held) return;
    isHeld.current = held;
    onHold(held);
  };
  const latest = useRef(onHold);
  useEffect(() => {
    latest.current = onHold;
  });
  // A button that goes away or can no longer be held is released.
  useEffect(
    () => () => {
      if (!isHeld.current) return;
      isHeld.current = false;
      latest.current(false);
    },
    [isDisabled],
  );
  return (
    <button
      type="button"
      className={`hold-button ${className}`}
      {...(label === undefined ? {} : { "aria-label": label })}
      disabled={isDisabled}
      onPointerDown={(event) => {
        if (event.button !== 0) return;
        event.currentTarget.setPointerCapture(event.pointerId);
        set(true);
      }}
      onPointerUp={() => set(false)}
      onPointerCancel={() => set(false)}
      onLostPointerCapture={() => set(false)}
      onKeyDown={(event) => {
        if (event.key === "Enter") set(true);
      }}
      onKeyUp={() => set(false)}
      onBlur={() => set(false)}
      onContextMenu={(event) => event.preventDefault()}
    >
      {children}
    </button>
  );
}
