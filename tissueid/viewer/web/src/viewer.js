// The page: what comes in, what is drawn, and what a person does.

import { Connection } from "./connection.js";
import { Hand } from "./hand.js";
import { History } from "./history.js";
import { Panel } from "./panel.js";
import { saveData, savePicture } from "./saving.js";
import { TissueScene } from "./scene.js";
import { Strips } from "./strips.js";
import { byId, startTheme } from "./theme.js";

// older than this is no picture of the present
const STALE_S = 0.5;
const AGES = 4096;

const marks = [];
const panel = new Panel();
const scene = new TissueScene(byId("scene"), byId("tags"));
const strips = new Strips(byId("strips"), marks);
const ages = [];
let hello = null;
let history = null;
let link = "connecting";
let linkWhy = "";
let pausedAt = null;
let lampsSince = 0;
let drawn = 0;
let lastMs = performance.now();

const connection = new Connection({
  hello(message) {
    hello = message;
    history = new History(message);
    lampsSince = 0;
    pausedAt = null;
    marks.length = 0;
    panel.show(message);
    scene.show(message);
    strips.show(message);
    hand.allow(message.session.pointer);
    byId("pause").setAttribute("aria-pressed", "false");
    showReplay(message.session.replay_s);
  },
  frame: (buffer, head) => history.add(buffer, head),
  status: (message) => { panel.recordingStopped = message.recording_stopped ?? panel.recordingStopped; },
  state(word, sentence, why = "") {
    link = word;
    linkWhy = why;
    byId("link").dataset.state = word;
    byId("link-word").textContent = sentence;
    if (word === "lost") panel.statusMs = -Infinity;
  },
});

const end = () => (pausedAt === null ? history.end : Math.max(pausedAt, history.begin + 1));
const hand = new Hand(
  scene,
  () => (history && history.size ? history.vector("position_m", history.end - 1) : null),
  (words) => connection.say(words),
);
hand.allow(false);
const switchTheme = startTheme(() => { scene.recolour?.(); strips.rebuild(); });

/** Everything the picture is made of, at one sample. */
function stateAt(n) {
  const ageS = connection.nowS() - history.value("time_s", history.end - 1);
  const replay = hello.session.replay_s !== null;
  return {
    position_m: history.vector("position_m", n),
    force_N: history.vector("force_N", n),
    device_N: history.reader("force_N")(n),
    tissue_N: history.value("tissue_force_N", n),
    depth_mm: history.value("depth_mm", n),
    surface_mm: history.value("surface_mm", n),
    tick: history.value("tick", n),
    state: history.value("state", n),
    fault: history.value("fault", n),
    ruptured: hello.lamps.some((lamp) => lamp.id === "rupture" && history.value("lamps", n) & lamp.bits),
    target_m: hand.target,
    ageS,
    replay,
    link,
    ended: connection.ended,
    paused: pausedAt !== null || (replay && connection.standsStill),
    stale: link !== "live" || (!connection.ended && !replay && ageS > STALE_S),
  };
}

function picture(nowMs) {
  requestAnimationFrame(picture);
  hand.step((nowMs - lastMs) / 1000);
  lastMs = nowMs;
  if (history === null || !history.size) return;
  const n = end() - 1;
  const state = stateAt(n);
  let lamps = 0;
  for (let i = Math.max(lampsSince, history.begin); i < history.end; i += 1) lamps |= history.value("lamps", i);
  lampsSince = history.end;
  panel.light(pausedAt === null ? lamps : 0, state, nowMs);
  panel.update(state, nowMs);
  veil(state);
  scene.place(state);
  strips.update(history, n + 1, nowMs);
  if (scene.draw(nowMs) && pausedAt === null && link === "live") {
    drawn += 1;
    ages.push(connection.nowS() - history.value("time_s", n));
    if (ages.length > AGES) ages.shift();
  }
  if (state.replay) followReplay(n);
}

/** A picture that is not of the present is greyed, and says why. */
function veil(state) {
  const stale = link === "live" ? "stale: nothing new has come" : `${byId("link-word").textContent}: ${linkWhy}`;
  const words = state.stale ? stale : state.ended ? "the session has ended" : state.paused ? "paused" : "";
  byId("veil").hidden = words === "";
  if (byId("veil").textContent !== words) byId("veil").textContent = words;
  document.body.classList.toggle("stale", state.stale);
}

function pause() {
  if (!history) return;
  const replay = hello.session.replay_s !== null;
  if (replay) {
    connection.standsStill = !connection.standsStill;
    connection.say({ play: { paused: connection.standsStill } });
  } else pausedAt = pausedAt === null ? history.end : null;
  byId("pause").setAttribute("aria-pressed", String(replay ? connection.standsStill : pausedAt !== null));
}

function annotate() {
  if (!history || !history.size) return;
  const time_s = history.value("time_s", end() - 1);
  const dialog = byId("note");
  byId("note-text").value = "";
  dialog.onclose = () => {
    const text = byId("note-text").value.trim();
    if (dialog.returnValue === "keep" && text) marks.push({ time_s, text });
  };
  dialog.returnValue = "";
  dialog.showModal();
}

function showReplay(lengthS) {
  connection.standsStill = false;
  byId("replay").hidden = lengthS === null;
  if (lengthS !== null) byId("seek").max = String(lengthS);
}

let beginS = null;
function followReplay(n) {
  if (history.begin === 0) beginS = history.value("time_s", 0);
  const at = beginS === null ? 0 : history.value("time_s", n) - beginS;
  if (document.activeElement !== byId("seek")) byId("seek").value = String(at);
  byId("at").textContent = `${at.toFixed(1)} of ${hello.session.replay_s.toFixed(1)} s`;
}

byId("seek").addEventListener("change", () => {
  connection.say({ play: { at_s: Number(byId("seek").value), paused: connection.standsStill } });
  byId("seek").blur();
});

const actions = {
  p: pause,
  a: annotate,
  s: () => history && saveData(hello, history, end(), marks),
  i: () => savePicture(scene),
  t: switchTheme,
};
["oblique", "front", "side", "top"].forEach((view, k) => { actions[k + 1] = () => scene.look(view); });
for (const button of document.querySelectorAll("[data-key]")) {
  button.addEventListener("click", actions[button.dataset.key]);
}
window.addEventListener("keydown", (event) => {
  if (event.target.matches("input, dialog *") || event.ctrlKey || event.metaKey || event.altKey) return;
  const action = actions[event.key.toLowerCase()];
  if (!action) return;
  event.preventDefault();
  action();
});

/** What the page holds, for whoever wants to check it: nothing here changes anything. */
window.tissueid = {
  read: () => (history === null || !history.size ? null : {
    link, drawn, dropped: connection.dropped, frames: connection.frames, samples: history.end,
    newest: stateAt(history.end - 1), traces: strips.read(), ages: [...ages], marks: [...marks],
    surface: scene.surface ? scene.surface.deformed : null,
  }),
};
// the connection is on its way, and what it shows is still to come
scene.rehearse();
requestAnimationFrame(picture);
