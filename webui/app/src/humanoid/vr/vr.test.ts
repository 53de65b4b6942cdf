/** The logic of virtual reality without a headset: frames, prediction, bounds, catching, holding, messages. */
import { Euler, Quaternion, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import type { LiveDocument } from "../humanoid";
import { BallPrediction, GRAVITY_MPS2 } from "./ball";
import { marginTo, outside } from "./bounds";
import cases from "./catching.fixture.json";
import { closest, Contact } from "./catching";
import { Durations } from "./durations";
import { recentred, SEAT_M, SEATED_EYES_M, toGround, toScene, turnToGround, yawOf } from "./frames";
import { Haptics } from "./haptics";
import { Holding } from "./holding";
import { Horizon } from "./horizon";
import { Measuring } from "./measuring";
import { poseMessage, type SentPose } from "./messages";
import { RobotClock } from "./robotClock";
import { StateTrack } from "./stateTrack";

const NOWHERE = { x: 0, y: 0, z: 0 };
/** The same numbers in each run. */
function* numbers(seed: number): Generator<number, never> {
  let state = seed;
  for (;;) {
    state = (1664525 * state + 1013904223) % 2 ** 32;
    yield state / 2 ** 32;
  }
}

describe("frames", () => {
  it("go to the ground and back for any anchor", () => {
    const random = numbers(1);
    for (let run = 0; run < 100; run += 1) {
      const [a, b, c, x, y, z] = Array.from({ length: 6 }, () => 4 * random.next().value - 2) as [number, number, number, number, number, number];
      const ground = { ...NOWHERE };
      const scene = { ...NOWHERE };
      toGround([a, b, c], { x, y, z }, ground);
      toScene([a, b, c], ground.x, ground.y, ground.z, scene);
      expect(Math.hypot(scene.x - x, scene.y - y, scene.z - z)).toBeLessThan(1e-12);
    }
  });

  it("turn a head that looks at the robot against the x axis of the ground, with z up", () => {
    for (const yaw of [0, 0.7, -2]) {
      const out = new Quaternion();
      turnToGround(yaw, new Quaternion().setFromEuler(new Euler(0, Math.PI / 2, 0)), out);
      const [looks, up] = [new Vector3(1, 0, 0).applyQuaternion(out), new Vector3(0, 0, 1).applyQuaternion(out)];
      expect(looks.distanceTo(new Vector3(-Math.cos(yaw), -Math.sin(yaw), 0))).toBeLessThan(1e-9);
      expect(up.distanceTo(new Vector3(0, 0, 1))).toBeLessThan(1e-9);
    }
  });

  it.each([true, false])("recentre any head to the seat, looking at the robot (ground known: %s)", (knowsGround) => {
    const random = numbers(2);
    for (let run = 0; run < 50; run += 1) {
      const head = new Vector3(random.next().value * 3, 1.2 + random.next().value, random.next().value * 3);
      const turn = new Quaternion().setFromEuler(new Euler(0.4 * random.next().value, 6 * random.next().value, 0, "YXZ"));
      const origin = recentred(head, turn, knowsGround);
      if (origin === null) throw new Error("no origin");
      const back = new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), -origin.yaw);
      const now = head.clone().sub(new Vector3(origin.x, origin.y, origin.z)).applyQuaternion(back);
      expect(Math.hypot(now.x - SEAT_M, now.z)).toBeLessThan(1e-9);
      expect(now.y).toBeCloseTo(knowsGround ? head.y : SEATED_EYES_M);
      expect(yawOf(back.multiply(turn))).toBeCloseTo(Math.PI / 2);
    }
  });

  it("do not recentre a head that looks up, or that is nowhere", () => {
    const up = new Quaternion().setFromEuler(new Euler(Math.PI / 2, 0, 0));
    expect(recentred(NOWHERE, up, true)).toBeNull();
    expect(recentred({ x: NaN, y: 1, z: 0 }, new Quaternion(), true)).toBeNull();
  });
});

describe("the ball", () => {
  const flight = (t: number) => ({ x: 0.1 + 1.4 * t, y: -0.2 * t, z: 0.7 + 2 * t - (GRAVITY_MPS2 / 2) * t * t });
  const flown = (rateHz: number, until: number) => {
    const ball = new BallPrediction();
    for (let t = 0; t <= until; t += 1 / rateHz) {
      const { x, y, z } = flight(t);
      ball.add(t, x, y, z);
    }
    return ball;
  };

  it.each([30, 50, 120])("is predicted to the eyes within 1 mm at %i states a second", (rateHz) => {
    const [at, ball, last] = [{ ...NOWHERE }, flown(rateHz, 0.3), Math.floor(0.3 * rateHz) / rateHz];
    for (const ahead of [0, 0.02, 0.05, 0.1]) {
      const truth = flight(last + ahead);
      expect(ball.at(last + ahead, at)).toBe(true);
      expect(Math.hypot(at.x - truth.x, at.y - truth.y, at.z - truth.z)).toBeLessThan(0.001);
    }
  });

  it("is not thrown off by a place twice, one from before, or one that is no number", () => {
    const [at, ball] = [{ ...NOWHERE }, flown(50, 0.3)];
    ball.add(0.3, 9, 9, 9);
    ball.add(0.1, 9, 9, 9);
    ball.add(0.32, NaN, 0, 0);
    ball.at(0.34, at);
    expect(Math.hypot(at.x - flight(0.34).x, at.z - flight(0.34).z)).toBeLessThan(0.001);
  });

  it("that bounces is shown where it was seen, not where it would have flown", () => {
    const [at, ball] = [{ ...NOWHERE }, flown(50, 0.3)];
    ball.add(0.32, 0.5, 0, 0.1);
    expect(ball.at(0.36, at)).toBe(true);
    expect(at).toEqual({ x: 0.5, y: 0, z: 0.1 });
    ball.clear();
    expect(ball.at(0.36, at)).toBe(false);
  });
});

it("the clock of the robot follows the least delay, adds half of the echo, and starts again with the robot", () => {
  const clock = new RobotClock();
  const random = numbers(3);
  expect(clock.isKnown).toBe(false);
  for (let index = 0; index < 500; index += 1) {
    const sent = index / 100;
    clock.receive(sent + 1000 + 0.004 + 0.02 * random.next().value ** 2, sent);
    clock.echo(0.008 + 0.03 * random.next().value ** 4);
  }
  expect(clock.now(1005)).toBeGreaterThan(4.995);
  expect(clock.now(1005)).toBeLessThan(5.01);
  clock.receive(1006, 0.1);
  expect(clock.arrived(1006)).toBeCloseTo(0.1);
});

it("the clock of a robot that is slower than ours runs ahead of what has arrived by a little only", () => {
  const clock = new RobotClock();
  for (let sent = 0; sent < 10; sent += 0.01) clock.receive(1000 + 2 * sent, sent);
  expect(clock.arrived(1020)).toBeGreaterThan(9.99);
  expect(clock.arrived(1020)).toBeLessThan(10.1);
});

describe("the states", () => {
  const state = (t: number, x: number, angle: number | null, turn = [0, 0, 0, 1]): Pick<LiveDocument, "t" | "base" | "joints"> => ({ t, base: [x, 0, 0.5, ...turn], joints: [angle] });

  it("are interpolated between two, and held outside", () => {
    const track = new StateTrack(1);
    expect(track.push(state(1, 0, 0))).toBe(true);
    expect(track.push(state(1, 5, 5))).toBe(false);
    track.push(state(1.1, 1, 0.5, [0, 0, 0, -1]));
    const { values } = track;
    track.sample(1.05);
    expect([...values]).toEqual([0.5, 0, 0.5, 0, 0, 0, 1, 0.25].map((each) => expect.closeTo(each, 9) as number));
    track.sample(0);
    expect(values[0]).toBe(0);
    track.sample(9);
    expect(values[0]).toBe(1);
    expect(track.values).toBe(values);
  });

  it("keep a value that a document lacks, and start again with the robot", () => {
    const track = new StateTrack(1);
    track.push(state(5, 0, 0.7));
    track.push(state(5.1, 1, null));
    expect(track.push({ t: 6, base: null, joints: [] })).toBe(false);
    track.sample(5.1);
    expect(track.values[7]).toBe(0.7);
    track.push(state(0.1, 3, 0));
    track.sample(0.05);
    expect(track.values[0]).toBe(3);
  });
});

describe("bounds", () => {
  const seated = { x: SEAT_M, y: 1.15, z: 0 };
  it.each([
    ["on the seat", seated, "seated", null],
    ["beside the seat", { ...seated, z: 0.7 }, "seated", "away"],
    ["standing up", { ...seated, y: 1.65 }, "seated", "high"],
    ["fallen", { ...seated, y: 0.3 }, "seated", "low"],
    ["standing", { ...seated, y: 1.65 }, "standing", null],
  ] as const)("a person %s", (_, head, posture, expected) => {
    expect(outside(head, posture, null)).toBe(expected);
  });

  it("are those of the drawn area for a person who stands", () => {
    const area = [[0, -1], [2, -1], [2, 1], [0, 1]].map(([x = 0, z = 0]) => ({ x, y: 0, z }));
    expect(marginTo({ x: 1, y: 0, z: 0 }, area)).toBeCloseTo(1);
    expect(marginTo({ x: 3, y: 0, z: 0 }, area)).toBeCloseTo(-1);
    expect(outside({ x: 1, y: 1.6, z: 0.5 }, "standing", area)).toBeNull();
    expect(outside({ x: 1.95, y: 1.6, z: 0 }, "standing", area)).toBe("away");
    expect(outside({ x: 4, y: 1.6, z: 0 }, "standing", area)).toBe("away");
  });
});

it.each(cases.cases)("a ball comes as near as the service counts it: $closestM m", ({ before, after, closestM, isCaught }) => {
  const [from, to] = [before, after].map(([x = 0, y = 0, z = 0]) => ({ x, y, z }));
  if (from === undefined || to === undefined) throw new Error("the case lacks a place");
  expect(closest(from, to)).toBeCloseTo(closestM, 9);
  expect(closest(from, to) <= cases.radiusM).toBe(isCaught);
});

it("a contact is felt once in a flight, also between two frames", () => {
  const contact = new Contact();
  const palm = { x: 0.8, y: 0, z: 0.7 };
  expect(contact.update({ x: 0.5, y: 0, z: 0.7 }, palm, 0.12)).toBe(false);
  expect(contact.update({ x: 1.1, y: 0, z: 0.7 }, palm, 0.12)).toBe(true);
  expect(contact.update(palm, palm, 0.12)).toBe(false);
  expect(contact.update(null, palm, 0.12)).toBe(false);
  expect(contact.update({ x: 0.5, y: 0, z: 0.7 }, null, 0.12)).toBe(false);
  expect(contact.update(palm, palm, 0.12)).toBe(true);
});

it("a hand holds only where it closes, until it opens, is torn away, or is not tracked", () => {
  const hand = new Holding();
  expect(hand.update(1, 0.3)).toBe(false);
  expect(hand.update(1, 0.05)).toBe(false); // it was closed before it came near
  expect(hand.update(0, 0.05)).toBe(false);
  expect(hand.update(1, 0.05)).toBe(true);
  expect(hand.update(1, 0.2)).toBe(true);
  expect(hand.update(1, 0.4)).toBe(false);
  expect(hand.update(1, 0.05)).toBe(false);
  for (const lost of [null, NaN]) {
    hand.update(0, 0.05);
    expect(hand.update(1, 0.05)).toBe(true);
    expect(hand.update(1, lost)).toBe(false);
  }
});

describe("a pose that is sent", () => {
  const turn = { x: 0, y: 0, z: 0, w: 1 };
  const sent = (more: Partial<SentPose>): SentPose => ({
    timeS: 4, anchor: [1, 0, 0], head: { x: 1, y: 1.1, z: 0 }, headTurn: turn, isTracked: true, isInBounds: true, isRecentred: false,
    hands: { left: { isTracked: true, position: { x: 0.7, y: 0.6, z: 0.2 }, turn, grip: 1.4 }, right: { isTracked: false, position: NOWHERE, turn, grip: 0 } },
    ...more,
  });

  it("has places on the ground of the robot", () => {
    const { headset, hands, tracking, inBounds } = poseMessage(sent({}));
    expect(headset?.position).toEqual([2, expect.closeTo(0, 9), 1.1]);
    expect(hands.left?.position).toEqual([1.7, expect.closeTo(-0.2, 9), 0.6]);
    expect([hands.left?.grip, hands.right, tracking, inBounds]).toEqual([1, null, "ok", true]);
  });

  it.each([
    ["a head that is no number", { head: { x: NaN, y: 1, z: 0 } }],
    ["a lost tracking", { isTracked: false }],
  ])("says that the tracking is lost, without hands, for %s", (_, more) => {
    const message = poseMessage(sent(more));
    expect(message).toMatchObject({ tracking: "lost", hands: { left: null, right: null } });
    expect(JSON.stringify(message)).not.toMatch(/NaN|Infinity/);
  });
});

it("durations are medians and 99 %, and the way of a pose is measured to the picture that answers it", () => {
  const durations = new Durations();
  expect(durations.quantiles()).toBeNull();
  for (let index = 1; index <= 100; index += 1) durations.add(index);
  durations.add(NaN);
  expect(durations.quantiles()).toEqual({ count: 100, median: 50, p99: 99 });
  const measuring = new Measuring();
  measuring.begin(100);
  measuring.sent(101);
  const first = measuring.worked(102, 101, true);
  measuring.received(110, 100);
  measuring.received(112, 100);
  measuring.begin(112);
  expect(measuring.worked(112.5, 112, false)).toBeNull(); // in software not each frame is drawn: it would have taken 1 ms
  measuring.begin(113);
  measuring.showsBall(125, 90);
  const second = measuring.worked(115, 114, true);
  if (first === null || second === null) throw new Error("no picture");
  measuring.drawn(first, 116); // the next frame was worked on before it was drawn
  measuring.begin(117);
  measuring.drawn(second, 118);
  const { ownHands, sent, answered, stateDrawn, poseWorked, poseDrawn, drawing, ball, ballAge } = measuring.figures();
  expect(ownHands).toEqual({ count: 2, median: 5, p99: 16 });
  expect(drawing).toEqual({ count: 2, median: 3, p99: 14 });
  expect([sent, answered, stateDrawn, poseWorked, poseDrawn, ball, ballAge].map((each) => each?.median)).toEqual([1, 10, 8, 13, 18, 7, 28]);
});

it("a picture is seen when the headset says it, else as long after its frame as was measured, and a period at least", () => {
  const horizon = new Horizon();
  for (let index = 0; index < 200; index += 1) horizon.begin(0, 1000 / 90, undefined);
  horizon.begin(0, 5000, NaN); // the page was hidden
  expect(horizon.ms).toBeCloseTo(1000 / 90);
  horizon.drawn(20);
  expect(horizon.ms).toBe(20);
  horizon.begin(1000, 11, 1025);
  expect(horizon.ms).toBe(25);
  for (const nonsense of [1000, 10, 9000]) {
    horizon.begin(1000, 11, nonsense);
    expect(horizon.ms).toBe(20);
  }
});

describe("haptic pulses", () => {
  const felt: string[] = [];
  const hand = (side: "left" | "right") => ({ isTracked: true, position: { x: side === "left" ? 1 : 0, y: 0, z: 0 }, pulse: (_: number, ms: number) => felt.push(`${side} ${ms}`) });
  const since = () => felt.splice(0);

  it("reach both hands once for a throw and for a pause, and every second outside of the bounds", () => {
    const haptics = new Haptics({ left: hand("left"), right: hand("right") });
    const document = (state: "running" | "paused", phase: "held" | "flying") => ({ session: { state }, ball: { phase } }) as unknown as Parameters<Haptics["receive"]>[0];
    haptics.receive(document("running", "held"));
    expect(since()).toEqual([]);
    haptics.receive(document("running", "flying"));
    haptics.receive(document("running", "flying"));
    expect(since()).toEqual(["left 40", "right 40"]);
    haptics.receive(document("paused", "flying"));
    haptics.receive(document("paused", "flying"));
    expect(since()).toEqual(["left 200", "right 200"]);
    haptics.warn(true, 1000);
    haptics.warn(true, 1500);
    haptics.warn(false, 2600);
    expect(since()).toEqual(["left 200", "right 200"]);
    haptics.warn(true, 2700);
    expect(since()).toEqual(["left 200", "right 200"]);
  });

  it("reach the hand that a ball touches, once for a flight", () => {
    const haptics = new Haptics({ left: hand("left"), right: hand("right") });
    haptics.touch({ x: 0, y: 0, z: 1 }, 0.12);
    haptics.touch({ x: 0, y: 0, z: -1 }, 0.12);
    haptics.touch({ x: 0, y: 0, z: 0 }, 0.12);
    expect(since()).toEqual(["right 30"]);
  });
});
