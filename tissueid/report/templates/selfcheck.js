"use strict";
// ECDF differences and rank histograms, drawn when they come into view.
(() => {
  const check = JSON.parse(document.getElementById("check").textContent);
  const total = check.simulations;
  const z = check.bands.points;
  const difference = (counts) => [0, ...counts.map((count, i) => count / total - z[i]), 0];
  const abscissa = [0, ...z, 1];

  const band = (name, words, opacity) => {
    const low = difference(check.bands[name].low);
    const high = difference(check.bands[name].high);
    const hidden = { mode: "lines", line: { width: 0 }, hoverinfo: "skip" };
    const fill = faint("data", opacity);
    return [
      { ...hidden, x: abscissa, y: low, showlegend: false },
      { ...hidden, x: abscissa, y: high, fill: "tonexty", fillcolor: fill, name: words },
    ];
  };
  const edge = (name, side, shown) => ({ x: abscissa, y: difference(check.bands[name][side]), mode: "lines", showlegend: shown,
    line: { color: colour("soft"), width: 1, dash: "dash" }, name: "99 % over all", legendgroup: "family", hoverinfo: "skip" });

  const figures = {
    ecdf: (one) => ({
      traces: [...band("99", "99 %", 0.25), ...band("95", "95 %", 0.35), edge("family", "low", false), edge("family", "high", true),
        { x: abscissa, y: difference(one.ecdf), mode: "lines", line: { color: colour("model"), width: 2, shape: "hv" }, name: "ranks",
          hovertemplate: "z %{x:.2f}: %{y:.4f}<extra></extra>" }],
      x: "z", y: "ECDF − z",
    }),
    histogram: (one) => {
      const bins = one.histogram.length;
      return {
        traces: [{ type: "bar", x: one.histogram.map((_, i) => (i + 0.5) / bins), y: one.histogram, width: 0.9 / bins, marker: { color: colour("data") }, name: "simulations",
          showlegend: false, hovertemplate: "%{y} ranks<extra></extra>" },
        { x: [0, 1], y: [total / bins, total / bins], mode: "lines", line: { color: colour("model"), width: 1.6 }, showlegend: false, hoverinfo: "skip" }],
        x: "Rank, as a share of the draws", y: "Simulations",
      };
    },
  };

  figureBoxes((box) => ({ layout: { xaxis: { range: [0, 1] } }, ...figures[box.dataset.figure](check.parameters[Number(box.dataset.parameter)]) }));
})();
