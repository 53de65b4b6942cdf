/** A joystick for a finger or a mouse: it moves two directions while it is dragged, and returns to rest. */
import { useEffect, useRef, useState, type PointerEvent } from "react";

export interface JoystickProps {
  label: string;
  onMove: (x: number, y: number) => void;
  /** Only up and down. */
  vertical?: boolean;
}

export function Joystick({ label, onMove, vertical = false }: JoystickProps) {
  const pad = useRef<HTMLDivElement>(null);
  const [place, setPlace] = useState<readonly [number, number]>([0, 0]);
  const latest = useRef(onMove);
  useEffect(() => {
    latest.current = onMove;
  });
  useEffect(() => () => latest.current(0, 0), []); // a joystick that goes away returns to rest
  const move = (x: number, y: number) => {
    setPlace([x, y]);
    onMove(x, y);
  };
  const follow = (event: PointerEvent) => {
    const box = pad.current?.getBoundingClientRect();
    if (box === undefined || !event.currentTarget.hasPointerCapture(event.pointerId)) return;
    const x = vertical ? 0 : (event.clientX - box.left - box.width / 2) / (box.width / 2);
    const y = -(event.clientY - box.top - box.height / 2) / (box.height / 2);
    const length = Math.max(1, Math.hypot(x, y));
    move(x / length, y / length);
  };
  return (
    <div
      ref={pad}
      className={vertical ? "joystick joystick--vertical" : "joystick"}
      role="img"
      aria-label={label}
      onPointerDown={(event) => {
        event.currentTarget.setPointerCapture(event.pointerId);
        follow(event);
      }}
      onPointerMove={follow}
      onPointerUp={() => move(0, 0)}
      onPointerCancel={() => move(0, 0)}
      onLostPointerCapture={() => move(0, 0)}
      onContextMenu={(event) => event.preventDefault()}
    >
      <div className="joystick__knob" style={{ left: `${50 + place[0] * 36}%`, top: `${50 - place[1] * 36}%` }} />
    </div>
  );
}
