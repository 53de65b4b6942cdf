/**
 * The view of the person who exercises: frames at the rate of the headset, or for a pointer without one.
 *
 * A frame reads the poses, moves robot and ball to where they are when it reaches the eyes, sends the poses, and draws.
 * The session is the service's: the view says what it sees (tracking, bounds), the service pauses.
 */
import type { Quaternion, Vector3 } from "three";
import { errorText, requestService } from "~/api/http";
import { localizedText } from "~/i18n/server";
import { mayDo } from "~/session/session";
import { inFrame, SERVICE, shownBall, SIDES, type Footprint, type HumanoidModel, type LiveDocument, type Place, type Side } from "../humanoid";
import { InputLink, type Answer } from "../inputLink";
import { HumanoidLive, OLD_MS } from "../liveState";
import { BallPrediction } from "./ball";
import { outside, type Outside, type Posture } from "./bounds";
import { Display } from "./display";
import { toGround, type Vector } from "./frames";
import { Haptics } from "./haptics";
import { Headset } from "./headset";
import { Holding } from "./holding";
import { Horizon } from "./horizon";
import { Measuring } from "./measuring";
import { poseMessage, type SentPose } from "./messages";
import { Pointer } from "./pointer";
import { RobotClock } from "./robotClock";
import { DEFAULT_REACH_M, Room } from "./room";
import { StateTrack } from "./stateTrack";
import type { PanelContent } from "./panel";
import { panelContent, type Act } from "./words";

/** Of a headset. */
const LIVE_HZ = 120;
const PANEL_EVERY_MS = 250;
/** How fast the scene follows a robot that walks, so that it does not sway with its steps. */
const FOLLOW_S = 0.5;
const HEIGHT_MPS = 0.5;
const OTHER: Readonly<Record<Side, Side>> = { left: "right", right: "left" };
const NO_THROW_HEIGHT_M = 0.6;

export type Using = "nothing" | "headset" | "pointer";

export interface ViewEvents {
  onUsing: (using: Using) => void;
  onAct: (act: Act) => void;
  /** The panel says something else. */
  onPanel: (content: PanelContent) => void;
}

export class VrView {
  readonly measuring = new Measuring();
  posture: Posture = "seated";
  /** Notice when a picture is drawn, and draw those that look the same. */
  isMeasuring = false;
  readonly #display: Display;
  readonly #room: Room;
  readonly #live = new HumanoidLive(LIVE_HZ);
  readonly #pointer = new Pointer();
  readonly #clock = new RobotClock();
  readonly #flight = new BallPrediction();
  readonly #horizon = new Horizon();
  readonly #track: StateTrack;
  readonly #holding: Record<Side, Holding> = { left: new Holding(), right: new Holding() };
  readonly #haptics: Haptics;
  readonly #events: ViewEvents;
  readonly #resized: ResizeObserver;
  readonly #end: () => void;
  readonly #anchor: [number, number, number] = [0, 0, 0];
  readonly #ballAt: Vector = { x: 0, y: 0, z: 0 };
  readonly #chosen: Vector = { x: 0, y: 0, z: 0 };
  readonly #robotHand: Vector3;
  readonly #sent: SentPose & { -readonly [Key in "timeS" | "isTracked" | "isInBounds" | "isRecentred"]: SentPose[Key] };
  #link: InputLink | null = null;
  #headset: Headset | null = null;
  #using: Using = "nothing";
  #document: LiveDocument | null = null;
  #receivedMs = -Infinity;
  #panelMs = -Infinity;
  #isAnchored = false;
  #outside: Outside | null = null;
  #said = "";
  #isChoosing = false;
  #hasChosen = false;
  #heightM = NO_THROW_HEIGHT_M;
  #aimed: string | null = null;
  #failure: string | null = null;
  #frameS = 0;

  /** Throws where the browser has no WebGL, or for a URDF that cannot be drawn. */
  constructor(host: HTMLElement, urdf: string, model: HumanoidModel, events: ViewEvents) {
    this.#events = events;
    this.#display = new Display(host);
    this.#room = new Room(urdf, model);
    this.#haptics = new Haptics(this.#room.hands);
    this.#robotHand = this.#pointer.camera.position.clone();
    this.#track = new StateTrack(model.joints.length);
    const { left, right } = this.#room.hands;
    const head = this.#pointer.camera;
    this.#sent = {
      timeS: 0, anchor: this.#anchor, head: head.position, headTurn: head.quaternion, isTracked: false, isInBounds: true, isRecentred: false,
      hands: { left: { isTracked: false, position: left.position, turn: left.turn, grip: 0 }, right: { isTracked: false, position: right.position, turn: right.turn, grip: 0 } },
    };
    const { canvas, renderer } = this.#display;
    canvas.addEventListener("pointermove", this.#moved);
    canvas.addEventListener("pointerdown", this.#pressed);
    canvas.addEventListener("pointerup", this.#released);
    canvas.addEventListener("pointerleave", this.#left);
    canvas.addEventListener("wheel", this.#wheeled, { passive: false });
    this.#resized = new ResizeObserver(() => this.#fit());
    this.#resized.observe(host);
    this.#end = this.#live.subscribe(() => this.#receive());
    this.#fit();
    renderer.setAnimationLoop((timeMs, frame) => this.#frame(timeMs, frame));
  }

  get document(): LiveDocument | null {
    return this.#document;
  }

  async enterHeadset(): Promise<void> {
    this.#headset = await Headset.enter(this.#display.renderer, {
      onEnd: () => this.#leftHeadset(),
      onSelect: (side) => this.#select(side),
      onPauseButton: () => this.#pauseOrResume(),
      onHidden: () => this.#say(false),
    });
    this.#room.scene.add(this.#headset.rig);
    this.#use("headset");
  }

  usePointer(): void {
    this.#use("pointer");
  }

  act(act: Act): void {
    const session = this.#document?.session;
    if (act === "recentre") this.#recentre();
    else if (act === "choose") this.#isChoosing = !this.#isChoosing;
    else if (act === "leave") void this.leave();
    else if (act === "pause" || act === "resume") {
      if (session != null) this.#post(`sessions/${session.id}/${act}`);
    } else this.#events.onAct(act);
  }

  async leave(): Promise<void> {
    if (this.#headset !== null) await this.#headset.leave();
    else this.#use("nothing");
  }

  /** Handle a key for the pointer; returns whether it had an effect. */
  key(key: string): boolean {
    if (this.#using !== "pointer") return false;
    if (key === "Enter") {
      this.#aim();
      if (this.#aimed !== null || this.#isChoosing) {
        this.#select("right");
        return true;
      }
    }
    return this.#pointer.key(key);
  }

  keyUp(key: string): void {
    if (key === " ") this.#pointer.isPressed = false;
  }

  fail(failure: string | null): void {
    this.#failure = failure;
    this.#panelMs = -Infinity;
  }

  dispose(): void {
    this.#display.renderer.setAnimationLoop(null);
    this.#use("nothing");
    void this.#headset?.leave();
    this.#end();
    this.#resized.disconnect();
    this.#room.dispose();
    this.#display.dispose();
  }

  #use(using: Using): void {
    if (using === this.#using) return;
    if (using === "nothing") this.#say(false); // the service pauses at once, not only by the silence
    this.#using = using;
    this.#link?.close();
    this.#link = using === "nothing" ? null : new InputLink("patient", (answer) => this.#answered(answer));
    this.#isAnchored = false;
    this.#isChoosing = false;
    this.measuring.clear();
    this.#events.onUsing(using);
  }

  #leftHeadset(): void {
    this.#headset?.rig.removeFromParent();
    this.#headset = null;
    this.#use("nothing");
    for (const side of SIDES) this.#room.hands[side].lose();
    this.#fit(); // the headset had a picture of another size
  }

  #recentre(): void {
    this.#headset?.recentre();
    this.#isAnchored = false;
  }

  #receive(): void {
    const { document, receivedMs } = this.#live.snapshot();
    if (document === null || receivedMs === this.#receivedMs) return;
    this.#receivedMs = receivedMs;
    this.#document = document;
    const pose = document.patient ?? null;
    this.measuring.received(receivedMs, pose === null ? null : 1000 * pose.t);
    if (document.t !== null && this.#track.push(document)) this.#clock.receive(receivedMs / 1000, document.t);
    const { ball, session } = document;
    if (ball?.phase !== "flying" || ball.position === null || document.t === null) this.#flight.clear();
    else this.#flight.add(document.t, ...ball.position);
    this.#haptics.receive(document);
    if (session?.state === "running" || document.behaviour !== "juggling") this.#isChoosing = false;
    for (const side of SIDES) this.#room.hands[side].setReach(session?.catch?.radiusM ?? DEFAULT_REACH_M);
  }

  #answered(answer: Answer): void {
    if (answer.kind === "echo") {
      const seconds = performance.now() / 1000 - answer.t;
      this.#clock.echo(seconds);
      this.measuring.add("echo", 1000 * seconds);
    } else if (answer.kind === "haptic") {
      this.#room.hands[answer.hand].pulse(answer.intensity, answer.ms);
    } else {
      this.fail(localizedText(answer, "reason"));
    }
  }

  #frame(timeMs: number, frame: XRFrame | undefined): void {
    const nowMs = performance.now();
    const dtS = Math.min(Math.max(timeMs / 1000 - this.#frameS, 0), 0.1);
    this.#frameS = timeMs / 1000;
    this.measuring.begin(nowMs);
    this.#horizon.begin(nowMs, 1000 * dtS, frame?.predictedDisplayTime);
    this.#readPerson(frame, dtS);
    this.#moveRobot(nowMs / 1000, dtS);
    this.#feel();
    if (this.#using !== "nothing") this.#say(true);
    this.#aim();
    if (nowMs - this.#panelMs > PANEL_EVERY_MS) this.#showPanel(nowMs);
    const drawsMs = performance.now();
    const isDrawn = this.#draw(nowMs); // where it is not, the hands were read and sent all the same
    const picture = this.measuring.worked(performance.now(), drawsMs, isDrawn);
    if (picture === null) return;
    if (!this.isMeasuring && !this.#display.isSlow) return;
    this.#display.end(nowMs, (drawnMs) => {
      this.measuring.drawn(picture, drawnMs);
      this.#horizon.drawn(drawnMs - picture.sampledMs);
    });
  }

  #draw(nowMs: number): boolean {
    const { scene } = this.#room;
    if (this.#headset !== null) return this.#display.drawForHeadset(nowMs, scene, this.#headset.camera);
    return this.#display.drawOnPage(nowMs, scene, this.#pointer.camera, this.isMeasuring);
  }

  #readPerson(frame: XRFrame | undefined, dtS: number): void {
    const { hands } = this.#room;
    const headset = this.#headset;
    if (headset !== null && frame !== undefined) {
      headset.read(frame, hands);
      this.#outside = headset.isTracked ? outside(headset.head, this.posture, headset.area) : null;
      this.#heightM = Math.min(Math.max(this.#heightM + headset.stick * HEIGHT_MPS * dtS, 0.05), 1.2);
    } else if (headset === null) {
      if (this.#using === "pointer") this.#pointer.place(hands);
      else for (const side of SIDES) hands[side].lose();
      this.#outside = null;
    }
    this.#room.showOutside(this.#outside !== null);
    this.#haptics.warn(this.#outside !== null, performance.now());
  }

  #moveRobot(nowS: number, dtS: number): void {
    if (!this.#track.isKnown || !this.#clock.isKnown) return;
    this.#track.sample(this.#clock.arrived(nowS) - this.#track.periodS);
    this.#follow(dtS);
    this.#room.anchorAt(this.#anchor);
    this.#room.body.pose(this.#track);
    this.#room.scene.updateMatrixWorld();
    const ball = this.#document === null ? null : shownBall(this.#document);
    const [now, aheadS] = [this.#clock.now(nowS), this.#horizon.ms / 1000];
    if (ball?.phase === "flying" && this.#flight.at(now + aheadS, this.#ballAt)) {
      this.#room.showBall(this.#anchor, this.#ballAt);
      this.measuring.showsBall(1000 * (nowS + aheadS), 1000 * (nowS - now + this.#flight.newestS));
    } else if (ball?.position != null) {
      [this.#ballAt.x, this.#ballAt.y, this.#ballAt.z] = ball.position;
      this.#room.showBall(this.#anchor, this.#ballAt);
    } else this.#room.showBall(this.#anchor, null);
    this.#room.showTarget(this.#anchor, ball?.target ?? null);
  }

  /** Keep the robot in front of the person: at once after recentring, and slowly while it walks with them. */
  #follow(dtS: number): void {
    const { values } = this.#track;
    const [qx, qy, qz, qw] = [values[3] ?? 0, values[4] ?? 0, values[5] ?? 0, values[6] ?? 1];
    const yaw = Math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz));
    const walks = this.#document?.behaviour === "assistedWalking" || this.#document?.behaviour === "walking";
    const share = this.#isAnchored ? (walks ? dtS / (FOLLOW_S + dtS) : 0) : 1;
    this.#isAnchored = true;
    const turn = Math.atan2(Math.sin(yaw - this.#anchor[2]), Math.cos(yaw - this.#anchor[2]));
    this.#anchor[0] += share * ((values[0] ?? 0) - this.#anchor[0]);
    this.#anchor[1] += share * ((values[1] ?? 0) - this.#anchor[1]);
    this.#anchor[2] += share * turn;
  }

  /** Feel the ball, and hold the hands of the robot in assisted walking; elsewhere a closed hand is one. */
  #feel(): void {
    const ball = this.#document?.ball?.phase === "flying" ? this.#room.ball : null;
    const reachM = this.#document?.session?.catch?.radiusM ?? DEFAULT_REACH_M;
    this.#haptics.touch(ball, reachM);
    const isWalking = this.#document?.session?.application === "walking" || this.#document?.behaviour === "assistedWalking";
    for (const side of SIDES) {
      const hand = this.#room.hands[side];
      const sent = this.#sent.hands[side] as { isTracked: boolean; grip: number };
      sent.isTracked = hand.isTracked;
      sent.grip = hand.grip;
      if (!isWalking) continue;
      const holding = this.#holding[side];
      const held = holding.holds;
      const isNear = hand.isTracked && this.#room.body.hand(OTHER[side], this.#robotHand);
      if (!holding.update(hand.grip, isNear ? this.#robotHand.distanceTo(hand.position) : null)) sent.grip = 0;
      if (holding.holds !== held) this.#haptics.contact(side);
    }
  }

  #say(isUsing: boolean): void {
    const link = this.#link;
    if (link === null) return;
    const sent = this.#sent;
    const { head, headTurn } = this.#head();
    sent.timeS = performance.now() / 1000;
    sent.isTracked = isUsing && this.#isTracked && document.visibilityState === "visible";
    sent.isInBounds = this.#outside === null;
    sent.isRecentred = this.#headset?.wasRecentred ?? false;
    if (!link.send(poseMessage({ ...sent, head, headTurn }))) return;
    if (this.#headset !== null) this.#headset.wasRecentred = false;
    this.measuring.sent(performance.now());
  }

  get #isTracked(): boolean {
    return this.#using === "headset" ? (this.#headset?.isTracked ?? false) : this.#using === "pointer";
  }

  #head(): { head: Vector3; headTurn: Quaternion } {
    const { position, quaternion } = this.#pointer.camera;
    return this.#headset === null ? { head: position, headTurn: quaternion } : { head: this.#headset.head, headTurn: this.#headset.headTurn };
  }

  #aim(): void {
    const { right, left } = this.#room.hands;
    const hand = right.hasRay ? right : left;
    const [from, turn] = [hand.rayFrom, hand.rayTurn];
    let hasRay = hand.hasRay;
    if (this.#headset === null && this.#using === "pointer" && this.#pointer.isThere) {
      this.#room.castFrom(this.#pointer.at, this.#pointer.camera, from, turn);
      hasRay = true;
    }
    this.#aimed = hasRay ? this.#room.aimAtPanel(from, turn) : null;
    const place = hasRay && this.#isChoosing && this.#aimed === null ? this.#room.aimAtHeight(from, turn, this.#heightM) : null;
    this.#hasChosen = place !== null;
    if (place !== null) toGround(this.#anchor, place, this.#chosen);
    this.#room.showChosen(place);
    const showsRays = this.#headset !== null && (this.#isChoosing || this.#document?.session?.state !== "running");
    for (const side of SIDES) this.#room.showRay(side, this.#room.hands[side], showsRays);
  }

  #select(side: Side): void {
    const aiming: Side = this.#room.hands.right.hasRay ? "right" : "left";
    if (side !== aiming && this.#headset !== null) return;
    if (this.#aimed !== null) this.act(this.#aimed as Act);
    else if (this.#isChoosing && this.#hasChosen) this.#throw();
  }

  /** Ask for a throw to the chosen place, in the frame of the feet, by the hand on that side. */
  #throw(): void {
    const document = this.#document;
    if (document === null) return;
    const stance: Footprint = document.stance ?? this.#anchor;
    const target: Place = inFrame(stance, [this.#chosen.x, this.#chosen.y, this.#chosen.z]);
    this.#post("throws", { target, hand: target[1] >= 0 ? "left" : "right" });
  }

  #pauseOrResume(): void {
    const state = this.#document?.session?.state;
    if (state === "running") this.act("pause");
    else if (state === "paused") this.act("resume");
  }

  #post(path: string, json?: unknown): void {
    this.fail(null);
    requestService(SERVICE, path, { method: "POST", ...(json === undefined ? {} : { json }) }).catch((error: unknown) => this.fail(errorText(error)));
  }

  #showPanel(nowMs: number): void {
    this.#panelMs = nowMs;
    const content = panelContent({
      document: this.#document,
      isOld: nowMs - this.#receivedMs > OLD_MS,
      isTracked: this.#using !== "headset" || this.#isTracked,
      outside: this.#outside,
      isChoosing: this.#isChoosing,
      mayChoose: mayDo("moveRobots"),
      mayExercise: mayDo("performTasks"),
      failure: this.#failure,
    });
    this.#room.panel.show(content);
    const said = JSON.stringify(content);
    if (said === this.#said) return;
    this.#said = said;
    this.#events.onPanel(content);
  }

  readonly #moved = ({ clientX, clientY }: PointerEvent): void => {
    const { left, top, width, height } = this.#display.canvas.getBoundingClientRect();
    this.#pointer.moveTo((2 * (clientX - left)) / width - 1, 1 - (2 * (clientY - top)) / height);
  };

  readonly #pressed = (event: PointerEvent): void => {
    if (this.#using !== "pointer") return;
    this.#moved(event);
    this.#aim();
    if (this.#aimed !== null || this.#isChoosing) this.#select("right");
    else this.#pointer.isPressed = true;
  };

  readonly #released = (): void => {
    this.#pointer.isPressed = false;
  };

  readonly #left = (): void => {
    this.#pointer.isThere = this.#pointer.isPressed = false;
  };

  readonly #wheeled = (event: WheelEvent): void => {
    if (this.#using !== "pointer") return;
    event.preventDefault();
    this.#pointer.deeper(event.deltaY < 0 ? 1 : -1);
  };

  #fit(): void {
    if (this.#headset === null) this.#display.fit(this.#pointer.camera);
  }
}
