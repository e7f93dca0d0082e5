"use strict";
// Every figure of the page, made from the packed curves when it comes into view.
(() => {
  const payload = JSON.parse(document.getElementById("curves").textContent);
  const bytes = (text) => Uint8Array.from(atob(text), (char) => char.charCodeAt(0));
  const floats = (text) => new Float32Array(bytes(text).buffer);
  const opened = new Map();
  const curves = (specimen) => {
    if (!opened.has(specimen)) {
      opened.set(specimen, payload.specimens[specimen].map((trial) => ({
        label: trial.label, t: floats(trial.t), x: floats(trial.x), f: floats(trial.f), m: floats(trial.m), on: bytes(trial.on),
        low: trial.low && floats(trial.low), high: trial.high && floats(trial.high),
      })));
    }
    return opened.get(specimen);
  };
  // figures of the trials that are chosen; the others show all
  const FOLLOW = new Set(["force-depth", "force-time", "residual"]);
  const chosen = (specimen) => {
    const choice = document.querySelector(`select[data-choice="${specimen}"]`);
    const all = curves(specimen);
    return !choice || choice.value === "all" ? all : [all[Number(choice.value)]];
  };
  const masked = (values, on, keep) => Array.from(values, (value, i) => (Boolean(on[i]) === keep ? value : null));

  const band = (trial, x, low, high, i) => outline(x, low, high, { name: "predicted", legendgroup: "predicted", showlegend: i === 0 });
  const bands = (trials, abscissa) => trials.filter((trial) => trial.low)
    .map((trial, i) => band(trial, trial[abscissa], trial.low, trial.high, i));
  const pairs = (trials, abscissa) => [...bands(trials, abscissa), ...lines(trials, abscissa)];
  // many lines beside each other would paint one broad brush: the picture of the result then shows one trial a speed
  const MOST_LINES = 8;
  const wide = (trials) => trials.length <= MOST_LINES;
  const deepest = (specimen) => payload.laws[specimen].speeds.map((group) => group.trials.map((k) => curves(specimen)[k])
    .reduce((a, b) => (b.x.reduce((m, x) => Math.max(m, x), 0) > a.x.reduce((m, x) => Math.max(m, x), 0) ? b : a)));
  const pictured = (specimen) => (wide(chosen(specimen)) ? chosen(specimen) : deepest(specimen));
  const lines = (trials, abscissa) => trials.flatMap((trial, i) => [
    { x: trial[abscissa], y: trial.f, mode: "lines", line: { color: colour("data"), width: wide(trials) ? 4 : 2 }, opacity: 0.6,
      name: "recorded", legendgroup: "recorded", showlegend: i === 0, text: trial.label, hovertemplate: "%{x:.4g}, %{y:.4g} N<br>%{text}<extra>recorded</extra>" },
    { x: trial[abscissa], y: trial.m, mode: "lines", line: { color: colour("model"), width: wide(trials) ? 1.6 : 0.8 },
      name: "model", legendgroup: "model", showlegend: i === 0, text: trial.label, hovertemplate: "%{x:.4g}, %{y:.4g} N<br>%{text}<extra>model</extra>" },
  ]).sort((a, b) => (a.name === b.name ? 0 : a.name === "recorded" ? -1 : 1));

  const aboutModel = (trial, ends) => ends.map((value, k) => value - trial.m[k]);
  const residuals = (specimen) => [
    // bands of many trials would hide each other and what they are about
    ...(chosen(specimen).length === 1 ? chosen(specimen) : []).filter((trial) => trial.low).map((trial, i) => band(trial, trial.t, aboutModel(trial, trial.low), aboutModel(trial, trial.high), i)),
    ...residualLines(specimen),
  ];
  const residualLines = (specimen) => chosen(specimen).flatMap((trial, i) => {
    const residual = trial.f.map((value, k) => value - trial.m[k]);
    const trace = (keep, name, ink) => ({ x: trial.t, y: masked(residual, trial.on, keep), mode: "lines", line: { color: colour(ink), width: 1 },
      name, legendgroup: name, showlegend: i === 0, text: trial.label, hovertemplate: "%{x:.4g} s, %{y:.3g} N<br>%{text}<extra></extra>" });
    const traces = [trace(true, "fitted", "model")];
    if (trial.on.includes(0)) traces.unshift(trace(false, "not fitted", "aside"));
    return traces;
  });

  const overview = () => {
    const points = payload.overview;
    return [{ x: points.map((p) => p.name), y: points.map((p) => p.value), mode: "markers", marker: { color: colour("model"), size: 8 },
      error_y: { type: "data", array: points.map((p) => p.up), arrayminus: points.map((p) => p.down), color: colour("data"), thickness: 2 },
      name: "viscosity", hovertemplate: "%{x}: %{y:.4g} N·s/mm<extra></extra>", showlegend: false }];
  };

  const known = posteriorKinds(payload, bytes);
  const kinds = {
    "force-depth": { traces: (s) => pairs(pictured(s), "x"), x: "Depth [mm]", y: "Force [N]" },
    "force-time": { traces: (s) => pairs(chosen(s), "t"), x: "Time from contact [s]", y: "Force [N]" },
    residual: { traces: residuals, x: "Time from contact [s]", y: "Residual [N]" },
    overview: { traces: overview, x: "", y: "Viscosity [N·s/mm]" },
    ...known.kinds,
    ...lawKinds(payload, curves, known.cloud),
  };

  // recordings may be normalised: labels are written in mm and N and read in the specimen's units
  const inUnits = (label, specimen) => {
    const units = payload.units[specimen];
    if (!units || (units.length === "mm" && units.force === "N")) return label;
    return label.replace("[N]", `[${units.force}]`).replace("Depth [mm]", units.length === "1" ? "Strain" : "Depth [mm]");
  };
  const redraw = figureBoxes((box) => {
    const kind = kinds[box.dataset.figure];
    const specimen = Number(box.dataset.specimen);
    const own = kind.own ? kind.own(specimen, box) : null;
    if (!own) return { traces: kind.traces(specimen), x: inUnits(kind.x, specimen), y: inUnits(kind.y, specimen) };
    // a grid of small axes says how high it is
    box.style.height = `${own.height}px`;
    return { traces: kind.traces(specimen), layout: own.layout };
  });
  document.querySelectorAll("select[data-choice]").forEach((choice) => {
    choice.addEventListener("change", () => redraw((box) => box.dataset.specimen === choice.dataset.choice && FOLLOW.has(box.dataset.figure)));
  });
  const follow = () => {
    const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (target && target.tagName === "DETAILS") { target.open = true; target.scrollIntoView(); }
  };
  addEventListener("hashchange", follow);
  follow();
})();
