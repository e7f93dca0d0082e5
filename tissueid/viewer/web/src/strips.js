// The strips: uPlot over time, and force over depth with the fitted band.  Every point is a sample.

import uPlot from "uplot";
import { colour } from "./theme.js";

const WINDOW_S = 10;
const GROUPS = 240;
const HEIGHT = 118;
const LOOP_HEIGHT = 190;
// one strip is drawn anew in each picture, none more often than this
const LEAST_MS = 70;

const hues = ["device", "tissue-line", "guide"];
const hueOf = (strip, i) => (strip.id === "force" ? hues[i] : i ? "guide" : "trace");
const font = "11px system-ui, sans-serif";

/** A range that moves in steps, so that an axis stands still while it can. */
function stepped(low, high) {
  const span = Math.max(high - low, 1e-9);
  const step = 10 ** Math.floor(Math.log10(span)) / 2;
  return [Math.floor(low / step) * step, Math.ceil(high / step + 1e-9) * step];
}

function range(least) {
  return (_plot, low, high) => (low === null || high === null ? [0, least] : stepped(Math.min(low, 0), Math.max(high, least)));
}

const LEAST = { force: 0.5, depth: 1, loop: 1, energy: 1, period: 200 };

function axis(extra) {
  return { stroke: colour("text"), grid: { stroke: colour("grid"), width: 1 }, ticks: { show: false }, font, size: 44, gap: 3, ...extra };
}

/** A plot in the place of the one before. */
function plotted(strip, options, data) {
  strip.plot?.destroy();
  const { parent } = strip;
  const plain = { width: parent.clientWidth, legend: { show: false }, cursor: { show: false }, padding: [6, 10, 0, 0] };
  return new uPlot({ ...plain, ...options }, data, parent);
}

/** A line between points of a plot, in a colour of the style sheet. */
function stroked({ ctx }, points, ink, width, dash = []) {
  ctx.strokeStyle = colour(ink);
  ctx.lineWidth = width * devicePixelRatio;
  ctx.setLineDash(dash.map((one) => one * devicePixelRatio));
  ctx.beginPath();
  points.forEach(([x, y]) => ctx.lineTo(x, y));
  ctx.stroke();
}

/** Least and most of a force strip's left axis, with what is drawn on the right axis brought to its scale. */
function shared(plot, traces, ratio) {
  const all = traces.flatMap((trace, i) => plot.data[i + 1].filter(Number.isFinite).map((one) => (trace.axis === "right" ? one / ratio : one)));
  return stepped(Math.min(0, ...all), Math.max(LEAST.force, ...all));
}

class TimeStrip {
  constructor(strip, parent, ratio) {
    Object.assign(this, { strip, parent, ratio });
  }

  build(marks) {
    const { strip } = this;
    const right = strip.traces.some((trace) => trace.axis === "right");
    this.plot = plotted(this, {
      height: HEIGHT,
      padding: [6, right ? 0 : 10, 0, 0],
      scales: {
        x: { time: false, range: () => [-WINDOW_S, 0] },
        // both forces coincide unless the device's was cut or ramped, and both stay in the plot
        y: { range: right && this.ratio ? (plot) => shared(plot, strip.traces, this.ratio) : range(LEAST[strip.id] ?? 1) },
        right: { range: (plot, low, high) => (this.ratio ? shared(plot, strip.traces, this.ratio).map((one) => one * this.ratio) : stepped(Math.min(low ?? 0, 0), Math.max(high ?? 0, 1))) },
      },
      series: [{}, ...strip.traces.map((trace, i) => ({
        label: trace.label, scale: trace.axis === "right" ? "right" : "y", stroke: colour(hueOf(strip, i)),
        width: i ? 1.2 : 1.8, dash: i ? [5, 3] : undefined, points: { show: false },
      }))],
      axes: [axis({ size: 22, gap: 7, values: (_p, at) => at.map((one) => `${one} s`) }), axis({ scale: "y" }), ...(right ? [axis({ scale: "right", side: 1, grid: { show: false } })] : [])],
      hooks: { draw: [(plot) => drawMarks(plot, marks, this.newestS)] },
    }, [[], ...strip.traces.map(() => [])]);
  }

  update(history, end) {
    const reads = this.strip.traces.map((trace) => history.trace(trace));
    this.newestS = history.value("time_s", end - 1);
    const begin = history.since(this.newestS - WINDOW_S);
    this.numbers = history.picked(reads[0], begin, end, GROUPS);
    const ages = this.numbers.map((n) => history.value("time_s", n) - this.newestS);
    this.plot.setData([ages, ...reads.map((read) => this.numbers.map(read))]);
  }

  /** What is drawn: times and values, read back from the plot itself. */
  read() {
    const [x, ...values] = this.plot.data;
    return { time_s: x.map((one) => one + this.newestS), numbers: this.numbers, right: [this.plot.scales.right.min, this.plot.scales.right.max], values: Object.fromEntries(this.strip.traces.map((trace, i) => [trace.id, values[i]])) };
  }
}

function drawMarks(plot, marks, newestS) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.fillStyle = colour("text");
  ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
  for (const mark of marks) {
    const at = mark.time_s - newestS;
    if (!(at >= -WINDOW_S && at <= 0)) continue;
    const x = plot.valToPos(at, "x", true);
    stroked(plot, [[x, bbox.top], [x, bbox.top + bbox.height]], "hand", 1);
    ctx.fillText(mark.text.slice(0, 18), x + 3, bbox.top + 11 * devicePixelRatio);
  }
  ctx.restore();
}

class LoopStrip {
  constructor(strip, parent, band) {
    Object.assign(this, { strip, parent, curves: band?.curves ?? [] });
  }

  build() {
    const furthest = Math.max(0, ...this.curves.flatMap((curve) => curve.depth_mm));
    const most = Math.max(0, ...this.curves.flatMap((curve) => curve.high_N ?? curve.force_N));
    this.plot = plotted(this, {
      mode: 2,
      height: LOOP_HEIGHT,
      scales: {
        x: { time: false, auto: true, range: (_p, low, high) => stepped(0, Math.max(high ?? 0, furthest, 1)) },
        y: { auto: true, range: (_p, low, high) => stepped(Math.min(low ?? 0, 0), Math.max(high ?? 0, most, 1)) },
      },
      series: [{}, { facets: [{ scale: "x", auto: true }, { scale: "y", auto: true }], stroke: colour("tissue-line"), paths: () => null }],
      axes: [axis({ size: 22, gap: 7, values: (_p, at) => at.map((one) => `${one} mm`) }), axis({})],
      hooks: { draw: [(plot) => this.draw(plot)] },
    }, [null, [[], []]]);
  }

  draw(plot) {
    const { ctx, bbox } = plot;
    const points = (xs, ys) => xs.map((x, i) => [plot.valToPos(x, "x", true), plot.valToPos(ys[i], "y", true)]);
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    this.curves.forEach((curve, i) => {
      if (curve.low_N) {
        const band = [...points(curve.depth_mm, curve.high_N), ...points(curve.depth_mm, curve.low_N).reverse()];
        ctx.fillStyle = colour("band");
        ctx.beginPath();
        band.forEach(([x, y]) => ctx.lineTo(x, y));
        ctx.fill();
      }
      stroked(plot, points(curve.depth_mm, curve.force_N), "curve", 1.2, i ? [] : [3, 3]);
    });
    const loop = points(...plot.data[1]);
    stroked(plot, loop, "tissue-line", 1.8);
    if (loop.length) {
      ctx.fillStyle = colour("tissue-line");
      ctx.beginPath();
      ctx.arc(...loop.at(-1), 3.5 * devicePixelRatio, 0, 7);
      ctx.fill();
    }
    ctx.restore();
  }

  update(history, end) {
    const [trace] = this.strip.traces;
    const force = history.trace(trace);
    const depth = history.reader(trace.over);
    const newestS = history.value("time_s", end - 1);
    this.numbers = history.picked(force, history.since(newestS - WINDOW_S), end, 2 * GROUPS).filter((n) => depth(n) > 0);
    this.times = this.numbers.map((n) => history.value("time_s", n));
    this.plot.setData([null, [this.numbers.map(depth), this.numbers.map(force)]]);
  }

  read() {
    const [depth, force] = this.plot.data[1];
    return { time_s: this.times, numbers: this.numbers, values: { depth_mm: depth, [this.strip.traces[0].id]: force } };
  }
}

export class Strips {
  constructor(parent, marks) {
    this.parent = parent;
    this.marks = marks;
    this.strips = [];
    this.turn = 0;
    new ResizeObserver(() => this.resize()).observe(parent);
  }

  show(hello) {
    this.parent.replaceChildren();
    this.strips = hello.strips.map((strip) => {
      const figure = document.createElement("figure");
      figure.id = `strip-${strip.id}`;
      const caption = document.createElement("figcaption");
      caption.append(`${strip.title} [${strip.unit}]`);
      const key = (className, textContent) => {
        caption.append(Object.assign(document.createElement("span"), { className: `key ${className}`, textContent }));
      };
      strip.traces.forEach((trace, i) => {
        const where = trace.axis === "right" ? " (right)" : "";
        if (strip.traces.length > 1) key(hueOf(strip, i), `${trace.label}${where}`);
      });
      const over = strip.traces.some((trace) => trace.over);
      if (over && hello.band) key("curve", hello.band.words);
      const place = document.createElement("div");
      figure.append(caption, place);
      this.parent.append(figure);
      return over ? new LoopStrip(strip, place, hello.band) : new TimeStrip(strip, place, hello.session.scale ? 1 / hello.session.scale.force_scale : null);
    });
    this.rebuild();
  }

  rebuild() {
    for (const strip of this.strips) {
      strip.build(this.marks);
      strip.drawnMs = -Infinity;
    }
  }

  resize() {
    for (const { plot, parent } of this.strips) if (plot && parent.clientWidth > 0 && plot.width !== parent.clientWidth) plot.setSize({ width: parent.clientWidth, height: plot.height });
  }

  /** Draw one strip anew, each in its turn. */
  update(history, end, nowMs) {
    if (!this.strips.length || history.size < 2) return;
    this.turn = (this.turn + 1) % this.strips.length;
    const strip = this.strips[this.turn];
    if (nowMs - strip.drawnMs < LEAST_MS) return;
    strip.drawnMs = nowMs;
    strip.update(history, end);
  }

  read() {
    return Object.fromEntries(this.strips.filter((strip) => strip.numbers).map((strip) => [strip.strip.id, strip.read()]));
  }
}
