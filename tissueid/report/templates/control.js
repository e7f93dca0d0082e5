"use strict";
// Curves of every loop against time; the loop that was asked for is drawn last, on top.
(() => {
  const control = JSON.parse(document.getElementById("control").textContent);
  const hues = ["model", "data", "soft"];

  const figure = (kind) => {
    const { curves, axis } = control.figures[kind];
    const traces = [];
    for (const [rank, run] of [...control.runs.entries()].reverse()) {
      for (const [position, [name, words]] of curves.entries()) {
        const [x, y] = run.curves[name];
        traces.push({ x, y, mode: "lines", name: words ? `${run.words}, ${words}` : run.words,
          line: { color: colour(hues[rank]), width: rank === 0 ? 2 : 1.4, dash: position === 0 ? "solid" : "dot" },
          hovertemplate: "%{x:.3f} s: %{y:.4g}<extra></extra>" });
      }
    }
    const truth = control.truth[curves[0][0]];
    if (truth !== undefined) {
      const end = control.runs[0].curves[curves[0][0]][0].at(-1);
      traces.push({ x: [0, end], y: [truth, truth], mode: "lines", name: "true", line: { color: colour("ink"), width: 1, dash: "dash" }, hoverinfo: "skip" });
    }
    return { traces, x: "Time [s]", y: axis };
  };

  figureBoxes((box) => figure(box.dataset.figure));
})();
