"use strict";
// Figures of a population, drawn when they come into view.
(() => {
  const chosen = document.getElementById("quantity");
  const across = (y, dash) => level(y, { color: colour("model"), width: 1.5, dash });
  const bar = (low, high, value) => ({ type: "data", symmetric: false, array: high.map((v, i) => v - value[i]), arrayminus: low.map((v, i) => value[i] - v), thickness: 1, width: 0 });

  const figures = {
    bands: () => {
      const { depth_mm: x, quantiles, typical } = payload.bands;
      const band = (low, high, opacity, name) => outline(x, quantiles[low], quantiles[high], { fillcolor: faint("data", opacity), name, showlegend: true });
      return {
        traces: [band(0, 4, 0.25, "95 % of specimens"), band(1, 3, 0.45, "68 % of specimens"),
          { x, y: typical, mode: "lines", line: { color: colour("model"), width: 2.5 }, name: "typical tissue", hovertemplate: "%{x:.2f} mm: %{y:.4g} N<extra></extra>" }],
        x: "Depth [mm]", y: "Force [N]",
      };
    },
    correlation: () => {
      const words = payload.quantities.map((one) => one.words);
      return {
        traces: [{ type: "heatmap", z: payload.correlation, x: words, y: words, zmin: -1, zmax: 1, zmid: 0,
          colorscale: [[0, "#0072b2"], [0.5, colour("paper")], [1, "#d55e00"]], colorbar: { title: { text: "r" }, thickness: 12 },
          text: payload.correlation.map((row) => row.map((r) => r.toFixed(2))), texttemplate: "%{text}", hovertemplate: "%{x}, %{y}: %{z:.2f}<extra></extra>" }],
        x: "", y: "", layout: { yaxis: { autorange: "reversed", automargin: true }, xaxis: { automargin: true, tickangle: -30 } },
      };
    },
    shrinkage: () => {
      const k = Number(chosen.value);
      const one = payload.quantities[k];
      const rows = [...payload.specimens].sort((a, b) => a.pooled[k] - b.pooled[k]);
      const trace = (kind, words, symbol, name, shift) => {
        const value = rows.map((row) => row[kind][k]);
        return { x: rows.map((_, i) => i + shift), y: value, mode: "markers", name: words,
          marker: { symbol: symbol, size: 7, color: rows.map((row) => row.outlier && kind === "pooled" ? colour("serious") : colour(name)) },
          error_y: { ...bar(rows.map((row) => row[`${kind}_ci95`][k][0]), rows.map((row) => row[`${kind}_ci95`][k][1]), value), color: colour(name) },
          text: rows.map((row) => row.name), hovertemplate: `%{text}: %{y:.4g} ${one.unit}<extra>${words}</extra>` };
      };
      const [low, top] = [-1, 1].map((sign) => one.median * Math.exp(sign * one.sd));
      return {
        traces: [trace("separate", "alone", "circle-open", "aside", -0.18), trace("pooled", "with the population", "circle", "data", 0.18)],
        x: "Specimen", y: one.unit ? `${one.words} [${one.unit}]` : one.words,
        layout: {
          shapes: [across(one.median, "solid"), { type: "rect", xref: "paper", x0: 0, x1: 1, y0: low, y1: top, fillcolor: faint("model", 0.1), line: { width: 0 }, layer: "below" }],
          yaxis: { type: "log" },
          xaxis: rows.length <= 40 ? { tickvals: rows.map((_, i) => i), ticktext: rows.map((row) => row.name) } : { showticklabels: false },
        },
      };
    },
    agreement: () => {
      const one = payload.agreement;
      const percent = (value) => 100 * value;
      return {
        traces: [{ x: one.pairs.map((pair) => pair.force_N), y: one.pairs.map((pair) => percent(pair.ln_ratio)), mode: "markers", marker: { color: colour("data"), size: 7 },
          text: one.pairs.map((pair) => pair.specimen), hovertemplate: "%{text}: %{y:.2f} %<extra></extra>", showlegend: false }],
        x: "Mean force of the pair at the common depth [N]", y: "Later less earlier [% of ln force]",
        layout: { shapes: [across(percent(one.bias), "solid"), across(percent(one.lower), "dash"), across(percent(one.upper), "dash")] },
      };
    },
    held_out: () => {
      const one = payload.held_out;
      const box = (values, words, name) => ({ type: "box", x: values, name: words, boxpoints: values.length <= 400 ? "all" : "outliers", jitter: 0.4, pointpos: 0,
        marker: { color: colour(name), size: 4 }, line: { color: colour(name) }, showlegend: false, hovertemplate: "%{x:.2f} %<extra></extra>" });
      return {
        traces: [box(one.mean, "by mean", "aside"), box(one.range, "by range", "data")],
        x: "NRMSD of the typical tissue of the others [%]", y: "",
        layout: { shapes: [{ type: "rect", yref: "paper", y0: 0, y1: 1, x0: one.paper_a[0], x1: one.paper_a[1], fillcolor: faint("model", 0.15), line: { width: 0 }, layer: "below" }], xaxis: { rangemode: "tozero" } },
      };
    },
  };

  const redraw = figureBoxes((box) => figures[box.dataset.figure]());
  chosen.addEventListener("change", () => redraw());
})();
