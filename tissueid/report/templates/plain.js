"use strict";
// Figures whose traces stand in the page; a colour of the page is named by `ink`.
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const inked = (part) => (part && part.ink ? { ...part, color: colour(part.ink) } : part);
  figureBoxes((box) => {
    const one = figures[Number(box.dataset.figure)];
    return { ...one, traces: one.traces.map((trace) => ({ ...trace, line: inked(trace.line), marker: inked(trace.marker) })) };
  });
})();
