"use strict";
// Two tissues beside each other: forces with bands along ramps and in a hold, and ratios with intervals.
(() => {
  const contrast = JSON.parse(document.getElementById("contrast").textContent);
  const hues = ["data", "model"];
  const of = (name) => contrast.curves.find((one) => one.name === name);

  // band first, median on top; the group hides both together
  const banded = (abscissa, curve, name, hue, dash, unit) => {
    const common = { x: abscissa, legendgroup: name, mode: "lines" };
    const hidden = { ...common, line: { width: 0 }, hoverinfo: "skip", showlegend: false };
    return [
      { ...hidden, y: curve.low, name: `${name}, 2.5 %` },
      { ...hidden, y: curve.high, fill: "tonexty", fillcolor: faint(hue, 0.25), name: `${name}, 97.5 %` },
      { ...common, y: curve.median, name, line: { color: colour(hue), width: 2, dash }, hovertemplate: `%{x:.3g} ${unit}: %{y:.4g} N<extra>${name}</extra>` },
    ];
  };

  const figures = {
    loading: (pair) => ({
      traces: [pair.one, pair.other].flatMap((name, rank) => of(name).loading.flatMap((curve, place, all) =>
        banded(curve.depth_mm, curve, `${name}, ${curve.speed_mm_s.toPrecision(3)} mm/s`, hues[rank], place < all.length - 1 ? "dash" : "solid", "mm"))),
      x: "Depth [mm]", y: "Force [N]",
    }),
    hold: (pair) => ({
      // the first point is time 0, which a logarithmic axis has not
      traces: [pair.one, pair.other].flatMap((name, rank) => {
        const { time_s, low, median, high } = of(name).hold;
        const curve = { low: low.slice(1), median: median.slice(1), high: high.slice(1) };
        return banded(time_s.slice(1), curve, name, hues[rank], "solid", "s");
      }),
      x: "Time after the ramp [s]", y: "Force [N]", layout: { xaxis: { type: "log" } },
    }),
    ratio: (pair) => {
      const rows = pair.numbers.filter((row) => row.ratio !== null).reverse();
      const middle = rows.map((row) => row.ratio[1]);
      return {
        traces: [
          { x: middle, y: rows.map((row) => row.name), mode: "markers", marker: { color: colour("model"), size: 9 }, showlegend: false, name: "ratio",
            error_x: { type: "data", symmetric: false, array: rows.map((row) => row.ratio[2] - row.ratio[1]), arrayminus: rows.map((row) => row.ratio[1] - row.ratio[0]), color: colour("model") },
            hovertemplate: "%{y}: %{x:.4g}<extra></extra>" },
        ],
        x: "Ratio", y: "", layout: { yaxis: { type: "category", automargin: true },
          shapes: [{ type: "line", x0: 1, x1: 1, y0: 0, y1: 1, yref: "paper", line: { color: colour("soft"), width: 1, dash: "dash" } }] },
      };
    },
  };

  figureBoxes((box) => figures[box.dataset.figure](contrast.pairs[Number(box.dataset.pair)]));
})();
