// Digits, lamps and words.

import { byId } from "./theme.js";

const DIGITS_MS = 60;
const STATUS_MS = 2000;
// a lamp stays lit this long after its tick, or nobody would see it
const AFTERGLOW_MS = 400;

const number = (value, digits) => (Number.isFinite(value) ? value.toFixed(digits) : "–");

export class Panel {
  show(hello) {
    this.hello = hello;
    document.title = `${hello.words.title} - tissueid`;
    for (const [id, words] of Object.entries(hello.words)) byId(id).textContent = words;
    this.lamps = hello.lamps.map((lamp) => {
      const shown = { id: `lamp-${lamp.id}`, textContent: lamp.word, title: lamp.meaning };
      const item = Object.assign(document.createElement("li"), shown);
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
      state.depth_mm > 0 ? `${number(state.depth_mm, 1)} ${this.hello.words["depth-words"]}` : "not touching",
      `${number(state.device_N, 1)} N at the device`,
      this.hello.session.blind ? "" : `${number(state.tissue_N, 0)} ${this.hello.words["tissue-words"]}`,
      ...(this.lit ?? []),
      state.fault ? this.hello.faults[state.fault] : "",
      state.paused ? "picture paused" : "",
      state.ended ? "the session has ended" : "",
      this.recordingStopped ? `recording stopped: ${this.recordingStopped}` : "",
    ];
    return parts.filter(Boolean).join(", ");
  }
}

function ageWords(ageS) {
  if (!Number.isFinite(ageS)) return "";
  return ageS < 1 ? `${Math.max(0, Math.round(1000 * ageS))} ms old` : `${ageS.toFixed(1)} s old`;
}
