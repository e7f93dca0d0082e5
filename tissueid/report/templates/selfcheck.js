"use strict";
// ECDF differences and rank histograms, drawn when they come into view.
(() => {
  const check = JSON.parse(document.getElementById("check").textContent);
  const total = check.simulations;
  const z = check.bands.points;
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const difference = (counts) => [0, ...counts.map((count, i) => count / total - z[i]), 0];
  const abscissa = [0, ...z, 1];

  const band = (name, words, opacity) => {
    const low = difference(check.bands[name].low);
    const high = difference(check.bands[name].high);
    const hidden = { mode: "lines", line: { width: 0 }, hoverinfo: "skip" };
    const fill = colour("data").replace(/^#(..)(..)(..)$/, (_, r, g, b) => `rgba(${[r, g, b].map((part) => parseInt(part, 16)).join(",")},${opacity})`);
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

  const axis = (title) => ({ title: { text: title }, gridcolor: colour("line"), zerolinecolor: colour("soft"), linecolor: colour("line"), automargin: true });
  const draw = (box) => {
    const figure = figures[box.dataset.figure](check.parameters[Number(box.dataset.parameter)]);
    const layout = {
      margin: { l: 56, r: 12, t: 28, b: 48 }, paper_bgcolor: colour("paper"), plot_bgcolor: colour("paper"),
      font: { color: colour("ink"), family: "system-ui, sans-serif", size: 13 },
      xaxis: { ...axis(figure.x), range: [0, 1] }, yaxis: axis(figure.y),
      legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom" }, hovermode: "closest",
    };
    box.dataset.drawn = "yes";
    return Plotly.react(box, figure.traces, layout, { responsive: true, displaylogo: false, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] });
  };
  const boxes = [...document.querySelectorAll("[data-figure]")];
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (entry.isIntersecting && !entry.target.dataset.drawn) draw(entry.target);
    }
  }, { rootMargin: "300px" });
  boxes.forEach((box) => seen.observe(box));
  const again = () => boxes.filter((box) => box.dataset.drawn).forEach(draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  matchMedia("print").addEventListener("change", again);
  addEventListener("beforeprint", () => boxes.forEach(draw));
})();
