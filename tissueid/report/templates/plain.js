"use strict";
// Figures whose traces stand in the page; a colour of the page is named by `ink`.
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const inked = (trace) => {
    const parts = ["line", "marker"].filter((name) => trace[name]?.ink);
    return { ...trace, ...Object.fromEntries(parts.map((name) => [name, { ...trace[name], color: colour(trace[name].ink) }])) };
  };
  figureBoxes((box) => {
    const one = figures[Number(box.dataset.figure)];
    return { ...one, traces: one.traces.map(inked) };
  });
})();
