import { afterEach, beforeEach, describe, expect, it, test, vi } from "vitest";
import type { StateView } from "~/api/generated/human-state";
import { LiveSignals } from "./liveSignals";
import { isWave, WaveBuffer, type Packet } from "./waveform";

const packet = (over: Partial<Packet> = {}): Packet => ({
  sensor: "strap", kind: "ecg", unit: "D82", rateHz: 10, startS: 100, endS: 100.2, channels: ["I"], values: [[1, 2, 3]], ...over,
});

describe("a waveform", () => {
  it("continues with each packet, and a gap breaks its line", () => {
    const wave = new WaveBuffer(packet());
    wave.push(packet(), 1);
    wave.push(packet({ startS: 100.3, values: [[4, null]] }), 2);
    expect(wave.columns()[1]).toEqual([1, 2, 3, 4, null]);
    expect(wave.columns()[0]).toEqual([100, 100.1, 100.2, 100.3, expect.closeTo(100.4)]);
    wave.push(packet({ startS: 102, values: [[5]] }), 3);
    expect(wave.columns()[1]).toEqual([1, 2, 3, 4, null, null, 5]);
    expect(wave.receivedMs).toBe(3);
  });

  it("keeps the last seconds only", () => {
    const wave = new WaveBuffer(packet());
    for (let second = 0; second < 600; second++) wave.push(packet({ startS: second, values: [Array.from({ length: 10 }, () => second)] }), second);
    const [times, values] = wave.columns();
    expect(times.length).toBe(values?.length);
    expect(times.length).toBeLessThanOrEqual(112);
    expect(times[0]).toBeGreaterThan(588);
    expect(times).toEqual([...times].sort((a, b) => a - b));
  });

  it("begins again when the clock of the sensor is set back", () => {
    const wave = new WaveBuffer(packet());
    wave.push(packet(), 1);
    wave.push(packet({ startS: 50, values: [[9]] }), 2);
    expect(wave.columns()).toEqual([[50], [9]]);
  });

  it("ignores a packet without values, rate or time", () => {
    const wave = new WaveBuffer(packet());
    for (const empty of [packet({ values: [[]] }), packet({ values: [] }), packet({ rateHz: null }), packet({ startS: NaN })]) wave.push(empty, 1);
    expect(wave.columns()).toEqual([[], []]);
    expect(wave.receivedMs).toBe(0);
  });
});

test("slow signals and maps are no waveforms", () => {
  expect(isWave(packet())).toBe(true);
  expect(isWave(packet({ rateHz: 1 }))).toBe(false);
  expect(isWave(packet({ rateHz: null }))).toBe(false);
  expect(isWave(packet({ kind: "pressureMap" }))).toBe(false);
});

describe("the live signals", () => {
  const state = { person: "aino" } as StateView;
  beforeEach(() => vi.stubGlobal("location", { protocol: "http:", host: "localhost" }));
  afterEach(() => vi.unstubAllGlobals());

  it("show a waveform for each signal, and a new one when its channels change", () => {
    const live = new LiveSignals("aino");
    live.take({ signals: [packet(), packet({ kind: "ppg" }), packet({ rateHz: 1, kind: "heartRate" })] }, 1);
    live.take({ signals: [packet({ startS: 100.3 })] }, 2);
    const before = live.snapshot().waves;
    expect(before.map(({ kind }) => kind)).toEqual(["ecg", "ppg"]);
    expect(before[0]?.columns()[0].length).toBe(6);
    live.take({ signals: [packet({ channels: ["I", "II"], values: [[1], [2]] })] }, 3);
    expect(live.snapshot().waves.map(({ channels }) => channels.length)).toEqual([2, 1]);
  });

  it("show nothing of the body when the consent ends", () => {
    const live = new LiveSignals("aino");
    live.take({ state }, 1);
    live.take({ signals: [packet(), packet({ kind: "pressureMap", channels: ["r0c0"], values: [[1, 7]] })] }, 2);
    expect(live.snapshot()).toMatchObject({ state, receivedMs: 1, maps: [{ values: [7] }] });
    live.take({ state: null }, 3);
    expect(live.snapshot()).toMatchObject({ state: null, waves: [], maps: [] });
  });
});
