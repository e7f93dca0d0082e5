"use strict";
// Figures of a specimen's law: holds, parts, peaks, residuals, profiles.
const units = (s) => payload.units[s] ?? payload.units[0];
const depth = (s) => (units(s).length === "mm" ? "Depth [mm]" : "Strain");
const force = (s) => `Force [${units(s).force}]`;
const lawKinds = (curves, draws) => {
  const law = (s) => payload.laws[s];
  const stiffness = (s) => `K [${units(s).length === "mm" ? "N/mm" : units(s).force}]`;
  const speed = (s) => `Loading speed [${units(s).length}/s]`;
  const line = (x, y, i, name, ink, more = {}) => ({ x, y, ...cell(i), mode: "lines", name, showlegend: false, line: { color: ink, width: 1.6 }, hovertemplate: `%{x:.4g}, %{y:.4g}<extra>${name}</extra>`, ...more });

  // force over the model's force where the window begins, so that holds of several depths share an axis
  const held = (s) => law(s).holds.flatMap((hold) => {
    const t = curves(s)[hold.trial], unit = t.m[t.t.findIndex((value) => value >= hold.start - 1e-6)];
    return unit === undefined ? [] : [{ hold, t, unit, length: hold.end - hold.start }];
  });
  const holdTraces = ({ hold, t, unit, length }) => {
    const part = (from, to, floor) => Array.from(t.t, (_, k) => k).filter((k) => t.t[k] - hold.start >= from && t.t[k] - hold.start <= to && t.t[k] - hold.start > floor);
    const both = (keep, i) => {
      const x = keep.map((k) => t.t[k] - hold.start);
      return [
        line(x, keep.map((k) => t.f[k] / unit), i, "recorded", colour("data"), { opacity: 0.5, text: hold.label, hovertemplate: "%{x:.4g} s, %{y:.4g}<br>%{text}<extra>recorded</extra>" }),
        line(x, keep.map((k) => t.m[k] / unit), i, "model", colour("model")),
      ];
    };
    return [...both(part(-0.08 * length, 1.03 * length, -Infinity), 0), ...both(part(0, length, 0.4 * hold.step), 1)];
  };
  const holds = (s, box) => {
    const every = law(s).holds.map((hold) => hold.end - hold.start);
    const ends = [...new Set([Math.min(...every), Math.max(...every)])];
    // the windows: their common start, and where the shortest and the longest end
    const shapes = [0, ...ends].map((x) => ({ type: "line", xref: "x", yref: "y domain", x0: x, x1: x, y0: 0, y1: 1, line: { color: colour("soft"), width: 1, dash: "dot" } }));
    const shares = held(s).flatMap(({ hold, t, unit }) => Array.from(t.f, (f) => f / unit)
      .filter((share, k) => t.t[k] >= hold.start && t.t[k] <= hold.end && Number.isFinite(share)));
    const low = shares.reduce((a, b) => Math.min(a, b), 1), high = shares.reduce((a, b) => Math.max(a, b), 1), room = 0.1 * (high - low);
    const y = (title) => named(title, { range: [low - room, high + room] });
    const layout = panels(box, 2, [
      ["", named("Time from the stop [s]"), y("Force over its start")],
      ["", decades("Time from the stop [s], log"), y("")],
    ], { shapes });
    return { traces: held(s).flatMap(holdTraces), layout, height: 300 * layout.grid.rows + 40 };
  };

  const banded = (x, part, i, name, ink, more) => [...(part.low ? [outline(x, part.low, part.high, { ...cell(i), name: `${name}, band` })] : []), line(x, part.value, i, name, ink, more)];
  const parts = (s, box) => {
    const known = law(s).parts;
    const traces = [
      ...banded(known.x, known.static, 0, "static force", colour("model")),
      ...known.dynamic.flatMap((part, k) => banded(known.x, part, 1, part.label, nth(INKS, k), { line: { color: nth(INKS, k), dash: nth(DASHES, k), width: 2 }, showlegend: true })),
      ...banded(known.x, known.stiffness, 2, "stiffness of the branches", colour("model")),
    ];
    const panel = (name, y) => [name, named(depth(s)), named(y, { rangemode: "tozero" })];
    const layout = panels(box, 3, [panel("static", `F_s [${units(s).force}]`), panel("dynamic, in loading", `F_d [${units(s).force}]`), panel("stiffness", stiffness(s))],
      { showlegend: true, legend: { orientation: "h", x: 0, y: -0.18, yanchor: "top" } });
    return { traces, layout, height: (layout.grid.rows > 1 ? 620 : 270) + 60 };
  };

  const peakTraces = (group, i) => {
    const ink = nth(INKS, i), same = { legendgroup: group.label };
    const sd = group.means.map((mean) => mean.sd);
    return [
      ...(group.line && group.line.low && group.line.speed.length > 1 ? [outline(group.line.speed, group.line.low, group.line.high, same)] : []),
      ...(group.line ? [{ x: group.line.speed, y: group.line.force, mode: "lines", name: `${group.label}, model`, ...same, showlegend: false, line: { color: ink, width: 1.4, dash: nth(DASHES, i) }, hovertemplate: "%{x:.4g}, %{y:.4g}<extra>model</extra>" }] : []),
      { x: group.points.map((p) => p.speed), y: group.points.map((p) => p.force), mode: "markers", name: `${group.label}, trials`, ...same, showlegend: false, marker: { color: ink, size: 5, opacity: 0.5, symbol: nth(MARKS, i) }, text: group.points.map((p) => p.label), hovertemplate: "%{x:.4g}, %{y:.4g}<br>%{text}<extra></extra>" },
      { x: group.means.map((m) => m.speed), y: group.means.map((m) => m.mean), mode: "markers", name: group.label, ...same, marker: { color: ink, size: 10, symbol: nth(MARKS, i), line: { color: colour("paper"), width: 1 } },
        error_y: { type: "data", array: sd.map((value) => value ?? 0), color: ink, thickness: 2, width: 6 }, text: group.means.map((m) => `${m.n} trial${m.n === 1 ? "" : "s"}${m.sd === null ? "" : `, SD ${m.sd.toPrecision(2)}`}`), hovertemplate: "%{x:.4g}, %{y:.4g}<br>%{text}<extra></extra>" },
    ];
  };
  const peaks = (s) => {
    const all = law(s).peaks.flatMap((group) => group.points.map((p) => p.speed));
    const wide = Math.max(...all) > 5 * Math.min(...all);
    // a tick a speed, as far as they keep out of each other's way
    const ticks = law(s).peaks.flatMap((group) => group.means.map((m) => Number(m.speed.toPrecision(2)))).sort((a, b) => a - b)
      .reduce((kept, value) => (kept.length && value < 1.3 * kept[kept.length - 1] ? kept : [...kept, value]), []);
    // of one speed there is no range
    const x = Math.max(...all) < 1.01 * Math.min(...all) ? { range: [0, 2 * all[0]] } : wide ? { type: "log", range: [Math.log10(Math.min(...all)) - 0.05, Math.log10(Math.max(...all)) + 0.05], ...(ticks.length <= 10 ? { tickvals: ticks, ticktext: ticks.map(String) } : {}) } : {};
    const traces = law(s).peaks.flatMap(peakTraces), layout = { xaxis: x, yaxis: { rangemode: "tozero" } };
    return { traces, x: speed(s), y: `Peak force [${units(s).force}]`, layout, height: 360 };
  };

  const residuals = (s, box) => {
    const known = law(s).residuals;
    const total = known.counts.reduce((a, b) => a + b, 0), inside = known.counts.slice(1, -1);
    const width = known.edges[1] - known.edges[0], middle = inside.map((_, i) => known.edges[i] + width / 2);
    const normal = middle.map((x) => (total * width * Math.exp(-0.5 * (x / known.sigma) ** 2)) / (known.sigma * Math.sqrt(2 * Math.PI)));
    const all = known.together;
    const traces = [
      { type: "bar", x: middle, y: inside, width: inside.map(() => width), ...cell(0), name: "residual", marker: { color: colour("data") }, hovertemplate: "%{x:.3g}: %{y}<extra></extra>" },
      line(middle, normal, 0, "normal noise of the fit", colour("model")),
      outline(all.lag, all.bound.map((value) => -value), all.bound, { ...cell(1), name: "white" }),
      ...known.correlation.map((one) => ({ x: one.lag, y: one.value, ...cell(1), mode: "markers", name: "one trial", marker: { color: colour("data"), size: 3, opacity: 0.6 }, text: one.label, hovertemplate: "%{x:.3g} s: %{y:.3f}<br>%{text}<extra></extra>" })),
      line(all.lag, all.value, 1, "all trials", colour("model"), { mode: "lines+markers", marker: { size: 5 } }),
      ...known.holds.map((one) => ({ x: one.since, y: one.mean, ...cell(2), mode: "markers", name: "one hold", marker: { color: colour("data"), size: 4, opacity: 0.7 }, text: one.label, hovertemplate: "%{x:.3g} s: %{y:.3g}<br>%{text}<extra></extra>" })),
      { x: known.pooled.since, y: known.pooled.mean, ...cell(2), mode: "lines+markers", name: "all holds", line: { color: colour("model"), width: 1.4 }, marker: { size: 6 },
        error_y: { type: "data", array: known.pooled.error, color: colour("model"), thickness: 1.4, width: 4 }, hovertemplate: "%{x:.3g} s: %{y:.3g}<extra>all holds</extra>" },
    ];
    const axes = [
      ["histogram", named(`Residual [${units(s).force}]`), named("Samples")],
      ["autocorrelation", decades("Lag [s]"), named("Correlation")],
      ["early in the holds", decades("Time since the corner [s]"), named(`Mean residual [${units(s).force}]`)],
    ];
    const layout = panels(box, 3, known.pooled.since.length ? axes : axes.slice(0, 2), { bargap: 0 });
    return { traces, layout, height: (layout.grid.rows > 1 ? 660 : 270) + 40 };
  };

  const profile = (s, box) => {
    const traces = law(s).profiles.flatMap((one, i) => {
      const found = draws(s, `relaxation_time_s${one.suffix}`, `stiffness_0_N_per_mm${one.suffix}`);
      const level = [one.tau[0], one.tau[one.tau.length - 1]];
      return [
        ...found.map(({ name, x, y }) => ({ x, y, ...cell(2 * i), mode: "markers", name, marker: { color: colour(name === "total" ? "data" : "model"), size: name === "total" ? 4 : 3, opacity: 0.35 }, hovertemplate: "%{x:.4g} s, %{y:.4g}<extra></extra>" })),
        line(one.tau, one.stiffness, 2 * i, "best K at each τ", colour("ink"), { line: { color: colour("ink"), width: 1.6 } }),
        line(one.tau, one.rise, 2 * i + 1, "rise", colour("model")),
        line(level, [3.84, 3.84], 2 * i + 1, "95 % level", colour("soft"), { line: { color: colour("soft"), width: 1, dash: "dash" } }),
      ];
    });
    const layout = panels(box, 2, law(s).profiles.flatMap(({ symbol }) => [
      [`K against ${symbol}`, decades(`${symbol} [s]`), named(stiffness(s), { rangemode: "tozero" })],
      [`profile likelihood of ${symbol}`, decades(`${symbol} [s]`), named("Rise of −2 ln L", { range: [0, 15] })],
    ]));
    return { traces, layout, height: 270 * layout.grid.rows + 40 };
  };

  return { holds, parts, peaks, residuals, profile };
};
