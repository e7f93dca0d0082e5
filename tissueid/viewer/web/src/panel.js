// Digits, lamps and words.

const DIGITS_MS = 60;
const STATUS_MS = 2000;
// a lamp stays lit this long after its tick, or nobody would see it
const AFTERGLOW_MS = 400;

const byId = (id) => document.getElementById(id);
const number = (value, digits) => (Number.isFinite(value) ? value.toFixed(digits) : "–");

/** A number with three significant digits and no exponent. */
export const short = (value) => String(Number(Number(value).toPrecision(3)));

export class Panel {
  show(hello) {
    this.hello = hello;
    const { session } = hello;
    byId("title").textContent = session.title;
    document.title = `${session.title} - tissueid`;
    const device = session.device.hardware ? session.device.name : `${session.device.name}, simulated: no motors`;
    byId("facts").textContent = [
      session.replay_s === null ? "" : `log of ${session.started}`,
      `device ${device}`,
      session.device.calibrated ? "" : "not calibrated",
      session.blind ? "blind" : "",
    ].filter(Boolean).join(" · ");
    byId("tissue-words").textContent = hello.digits.tissue;
    byId("depth-words").textContent = hello.digits.depth;
    byId("scale").textContent = session.scale !== null ? scaleWords(session) : hello.scene.kind === "guidance" ? "forces and motion are the device's own" : "a force law of its own: no scale is known";
    this.lamps = [...hello.lamps, { id: "stale", word: "Stale", meaning: "nothing new has come" }, { id: "fault", word: "Fault", meaning: "the device is off" }, { id: "recording", word: "Recording stopped", meaning: "the session goes on unrecorded" }].map((lamp) => {
      const item = document.createElement("li");
      item.id = `lamp-${lamp.id}`;
      item.textContent = lamp.word;
      item.title = lamp.meaning;
      return { ...lamp, item, litMs: -Infinity };
    });
    byId("lamps").replaceChildren(...this.lamps.map((lamp) => lamp.item));
    this.digitsMs = this.statusMs = -Infinity;
    this.recordingStopped = null;
  }

  /** Light the lamps of all samples since the last picture. */
  light(lamps, state, nowMs) {
    this.lit = [];
    for (const lamp of this.lamps) {
      if (lamp.bits && lamps & lamp.bits) lamp.litMs = nowMs;
      const own = { stale: state.stale, fault: state.fault !== 0, recording: this.recordingStopped !== null };
      const lit = own[lamp.id] ?? nowMs - lamp.litMs < AFTERGLOW_MS;
      if (lamp.id === "recording") lamp.item.hidden = !lit;
      lamp.item.classList.toggle("lit", lit);
      if (lit) this.lit.push(lamp.word.toLowerCase());
    }
  }

  update(state, nowMs) {
    if (nowMs - this.digitsMs > DIGITS_MS) {
      this.digitsMs = nowMs;
      const force = byId("device-force");
      force.textContent = number(state.device_N, 2);
      force.dataset.tick = state.tick;
      byId("tissue-force").textContent = this.hello.session.blind ? "–" : number(state.tissue_N, 1);
      byId("depth").textContent = number(Math.max(state.depth_mm, 0), 2);
      byId("age").textContent = state.replay ? "" : ageWords(state.ageS);
    }
    if (nowMs - this.statusMs > STATUS_MS) {
      this.statusMs = nowMs;
      const words = this.words(state);
      if (byId("status").textContent !== words) byId("status").textContent = words;
    }
  }

  words(state) {
    if (state.link !== "live") return byId("link-word").textContent;
    const parts = [
      this.hello.states[state.state],
      state.depth_mm > 0 ? `${number(state.depth_mm, 1)} ${this.hello.digits.depth}` : "not touching",
      `${number(state.device_N, 1)} N at the device`,
      this.hello.session.blind ? "" : `${number(state.tissue_N, 0)} ${this.hello.digits.tissue}`,
      ...(this.lit ?? []),
      state.fault ? this.hello.faults[state.fault] : "",
      state.paused ? "picture paused" : "",
      state.ended ? "the session has ended" : "",
      this.recordingStopped ? `recording stopped: ${this.recordingStopped}` : "",
    ];
    return parts.filter(Boolean).join(", ");
  }
}

function scaleWords({ scale, device }) {
  const clipped = scale.clipped_share_expected ?? 0;
  const stiffness = scale.device_stiffness_N_per_m;
  return [
    `felt force = tissue force × ${short(scale.force_scale)}`,
    `motion × ${short(scale.motion_scale)}`,
    stiffness === undefined ? "" : `device stiffness up to ${short(stiffness)} N/m`,
    `clamp ${short(device.clamp_N)} N`,
    `${short(100 * clipped)} % of the depth clipped`,
  ].filter(Boolean).join(" · ");
}

function ageWords(ageS) {
  if (!Number.isFinite(ageS)) return "";
  return ageS < 1 ? `${Math.max(0, Math.round(1000 * ageS))} ms old` : `${ageS.toFixed(1)} s old`;
}
