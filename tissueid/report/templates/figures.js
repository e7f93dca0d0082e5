"use strict";
// The figures of the page, made from the packed curves when they come into view.
(() => {
  const curves = once((specimen) => payload.specimens[specimen].map(({ label, on, ...packed }) => ({
    label, on: bytes(on), ...Object.fromEntries(Object.entries(packed).map(([key, text]) => [key, floats(text)])),
  })));
  // many lines beside each other would paint one broad brush: of many trials the deepest of each speed is shown
  const MOST_LINES = 8;
  const chosen = (specimen) => {
    const choice = document.querySelector(`select[data-choice="${specimen}"]`), every = curves(specimen);
    if (choice && choice.value !== "all") return [every[Number(choice.value)]];
    return every.length <= MOST_LINES ? every : payload.laws[specimen].deepest.map((k) => every[k]);
  };
  // where samples are far apart each of them is a dot
  const FEW_SAMPLES = 600;

  // force against time with the residual below it, and force against depth: every sample as it was recorded
  const mainTraces = (trials) => {
    const dots = trials.reduce((sum, trial) => sum + trial.f.length, 0) <= FEW_SAMPLES;
    const pair = (abscissa, i) => [
      ...trials.map((trial, k) => ({ x: trial[abscissa], y: trial.f, ...cell(i), mode: dots ? "lines+markers" : "lines",
        line: { color: colour("data"), width: 1.5 }, marker: { color: colour("data"), size: 4 }, name: "recorded", legendgroup: "recorded", showlegend: i === 0 && k === 0,
        text: trial.label, hovertemplate: "%{x:.4g}, %{y:.4g}<br>%{text}<extra>recorded</extra>" })),
      ...trials.map((trial, k) => ({ x: trial[abscissa], y: trial.m, ...cell(i), mode: "lines", line: { color: colour("model"), width: 1.4 },
        name: "model", legendgroup: "model", showlegend: i === 0 && k === 0, text: trial.label, hovertemplate: "%{x:.4g}, %{y:.4g}<br>%{text}<extra>model</extra>" })),
    ];
    return [...pair("t", 0), ...residual(trials), ...pair("x", 2)];
  };
  const residual = (trials) => {
    const below = { xaxis: "x", yaxis: "y2" };
    const masked = (values, on, keep) => Array.from(values, (value, i) => (Boolean(on[i]) === keep ? value : null));
    const about = (trial, ends) => ends.map((value, k) => value - trial.m[k]);
    // bands of several trials would hide each other and what they are about
    const band = trials.length === 1 && trials[0].low ? [outline(trials[0].t, about(trials[0], trials[0].low), about(trials[0], trials[0].high), { ...below, name: "predicted" })] : [];
    return [...band, ...trials.flatMap((trial) => {
      const left = trial.f.map((value, k) => value - trial.m[k]);
      const trace = (keep, name, ink) => ({ x: trial.t, y: masked(left, trial.on, keep), ...below, mode: "lines", line: { color: colour(ink), width: 1 },
        name, showlegend: false, text: trial.label, hovertemplate: "%{x:.4g} s, %{y:.3g}<br>%{text}<extra></extra>" });
      return [...(trial.on.includes(0) ? [trace(false, "not fitted", "aside")] : []), trace(true, "fitted", "model")];
    })];
  };
  const main = (specimen, box) => {
    const trials = chosen(specimen), beside = box.clientWidth >= 800;
    const place = (title, domain, more) => named(title, { domain, nticks: 8, ...more });
    const layout = { margin: { l: 56, r: 12, t: 28, b: 40 } };
    axesOf(layout, 0, place("Time from contact [s]", beside ? [0, 0.6] : [0, 1], { anchor: "y2" }), place(force(specimen), beside ? [0.32, 1] : [0.62, 1], {}));
    // what was not fitted may leave far more than what was
    const left = trials.reduce((most, trial) => trial.f.reduce((m, f, k) => (trial.on[k] ? Math.max(m, Math.abs(f - trial.m[k])) : m), most), 0);
    layout.yaxis2 = place(`Residual [${units(specimen).force}]`, beside ? [0, 0.26] : [0.43, 0.57], { nticks: 5, ...(left > 0 ? { range: [-1.25 * left, 1.25 * left] } : {}) });
    layout.xaxis3 = place(depth(specimen), beside ? [0.67, 1] : [0, 1], { anchor: "y3" });
    layout.yaxis3 = place(beside ? "" : force(specimen), beside ? [0, 1] : [0, 0.33], { anchor: "x3" });
    return { traces: mainTraces(trials), layout, height: beside ? 370 : 620 };
  };

  // every curve of a program, its mean and one standard deviation about it; a trace that is an area has no corner of its own
  const groupTraces = (specimen) => (one, g) => {
    const ink = nth(INKS, g), same = { legendgroup: one.label, showlegend: false };
    const faded = one.members.flatMap(([s, k]) => {
      const trial = curves(specimen < 0 ? s : specimen)[k];
      const deep = trial.x.reduce((a, b) => Math.max(a, b)), stop = trial.x.findIndex((x) => x - trial.x[0] >= 0.999 * (deep - trial.x[0]));
      const line = (x, y, i) => ({ x, y, ...cell(i), ...same, mode: "lines", line: { color: ink, width: 1 }, opacity: 0.45, name: "recorded", text: trial.label, hovertemplate: "%{x:.4g}, %{y:.4g}<br>%{text}<extra></extra>" });
      return [line(trial.x.slice(0, stop + 1), trial.f.slice(0, stop + 1), 0), line(trial.t.slice(stop).map((t) => t - trial.t[stop]), trial.f.slice(stop), 1)];
    });
    const mean = [one.loading, one.hold].flatMap((part, i) => (part ? [
      outline(part.x, part.mean.map((m, k) => m - part.sd[k]), part.mean.map((m, k) => m + part.sd[k]), { ...cell(i), ...same, name: "SD", fillcolor: `${ink}33` }),
      { x: part.x, y: part.mean, ...cell(i), ...same, mode: "lines", line: { color: ink, width: 2.6, dash: nth(DASHES, g) }, name: "mean", text: part.n, hovertemplate: "%{x:.4g}, %{y:.4g}, n = %{text}<extra>mean</extra>" },
    ] : []));
    return [...faded, ...mean, { x: [null], y: [null], ...cell(0), mode: "lines", line: { color: ink, width: 2.6, dash: nth(DASHES, g) }, name: one.label, legendgroup: one.label }];
  };
  const group = (specimen, box) => {
    const groups = specimen < 0 ? payload.groups : payload.laws[specimen].groups;
    const legend = { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", font: { size: 11 } };
    const layout = panels(box, 2, [
      ["", named(depth(specimen)), named(force(specimen))], ["", named("Time since the stop [s]"), named("")],
    ], { showlegend: groups.length <= 12, legend });
    if (layout.grid.rows > 1) layout.yaxis2 = named(force(specimen));
    return { traces: groups.flatMap(groupTraces(specimen)), layout, height: 320 * layout.grid.rows + 40 };
  };

  const overview = () => {
    const points = payload.overview;
    const traces = [{ x: points.map((p) => p.name), y: points.map((p) => p.value), mode: "markers", marker: { color: colour("model"), size: 8 },
      error_y: { type: "data", array: points.map((p) => p.up), arrayminus: points.map((p) => p.down), color: colour("data"), thickness: 2 },
      name: "viscosity", hovertemplate: "%{x}: %{y:.4g}<extra></extra>", showlegend: false }];
    return { traces, x: "", y: "Viscosity [N·s/mm]", height: 300 };
  };

  const known = posteriorKinds();
  const kinds = { main, group, overview, ...known.kinds, ...lawKinds(curves, known.cloud) };
  const redraw = figureBoxes((box) => kinds[box.dataset.figure](Number(box.dataset.specimen), box));
  document.querySelectorAll("select[data-choice]").forEach((choice) => {
    choice.addEventListener("change", () => redraw((box) => box.dataset.specimen === choice.dataset.choice && box.dataset.figure === "main"));
  });
  followLinks();
})();
