"use strict";
// Figures of the papers, drawn when they come into view.
(() => {
  const { figures } = JSON.parse(document.getElementById("check").textContent);
  // lines that can be told apart without their colour
  const colours = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a8f96", "#5a4fa2"];
  const dashes = { line: "solid", dash: "dash" };
  const traces = (figure) => figure.traces.flatMap((one, place) => {
    const shade = colours[place % colours.length];
    const look = one.style === "points"
      ? { mode: "markers", marker: { color: shade, size: 4 } }
      : { mode: "lines", line: { color: shade, width: 2, dash: dashes[one.style] } };
    const shown = { x: one.x, y: one.y, name: one.name, hovertemplate: "%{x:.4g}: %{y:.4g}", ...look };
    if (!one.band) return [shown];
    const hidden = { mode: "lines", line: { width: 0 }, hoverinfo: "skip", showlegend: false, x: one.x };
    return [{ ...hidden, y: one.band.low }, { ...hidden, y: one.band.high, fill: "tonexty", fillcolor: faint("data", 0.25) }, shown];
  });
  figureBoxes((box) => {
    const figure = figures[Number(box.dataset.place)];
    return { traces: traces(figure), x: figure.x_title, y: figure.y_title, layout: figure.x_log ? { xaxis: { type: "log" } } : {} };
  });
})();
