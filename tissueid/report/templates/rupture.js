"use strict";
// Figures of a study of ruptures, drawn when they come into view.
(() => {
  const found = JSON.parse(document.getElementById("rupture").textContent);
  const names = [...new Set(found.tests.map((one) => one.specimen))];

  const againstSpeed = (what, title, unit) => {
    const own = names.map((name) => found.tests.filter((one) => one.specimen === name && one.ruptured).sort((a, b) => a.speed - b.speed));
    const lines = own.map((tests) => ({ x: tests.map((one) => one.speed), y: tests.map((one) => one[what]), mode: "lines+markers",
      line: { color: faint("data", 0.35), width: 1 }, marker: { color: colour("data"), size: 6 }, showlegend: false,
      text: tests.map((one) => one.specimen), hovertemplate: `%{text}: %{y:.4g} ${unit} at %{x:.4g} mm/min<extra></extra>` }));
    const shown = found.speeds.filter((row) => row[what][0] !== null);
    const mean = { x: shown.map((row) => row.speed), y: shown.map((row) => row[what][0]), mode: "markers", name: "mean ± SD",
      marker: { color: colour("model"), size: 10, symbol: "diamond" },
      error_y: { type: "data", array: shown.map((row) => row[what][1] ?? 0), color: colour("model"), thickness: 2, width: 6 },
      hovertemplate: `mean %{y:.4g} ${unit} at %{x:.4g} mm/min<extra></extra>` };
    return { traces: [...lines, mean], x: "Speed [mm/min]", y: `${title} [${unit}]`, layout: { xaxis: { type: "log" }, yaxis: { rangemode: "tozero" } } };
  };

  const figures = {
    force: () => againstSpeed("force", "Force at rupture", "N"),
    work: () => againstSpeed("work", "Work to rupture", "N mm"),
    criteria: () => {
      const colours = { work: "data", "weighted-force": "model", "stored-energy": "aside", depth: "serious" };
      // side by side, so that marks of one speed do not hide each other
      const shift = (k) => 1.06 ** (k - 1.5);
      const traces = found.criteria.map((row, k) => ({
        x: found.tests.map((one) => one.speed * shift(k)), y: found.tests.map((one) => one.measures[row.name] / row.median), mode: "markers", name: row.words,
        visible: row.name === found.likeliest || row.name === "depth" || row.name === "work" ? true : "legendonly",
        marker: { color: colour(colours[row.name]), size: 8, symbol: found.tests.map((one) => one.ruptured ? "circle" : "circle-open") },
        text: found.tests.map((one) => one.specimen), hovertemplate: `%{text}: %{y:.3f} of ${row.median.toPrecision(4)} ${row.unit}<extra>${row.words}</extra>`,
      }));
      const level = { type: "line", xref: "paper", x0: 0, x1: 1, y0: 1, y1: 1, line: { color: colour("soft"), width: 1 } };
      return { traces, x: "Speed [mm/min]", y: "Reached over median", layout: { xaxis: { type: "log" }, yaxis: { type: "log" }, shapes: [level] } };
    },
  };
  figureBoxes((box) => figures[box.dataset.figure]());
})();
