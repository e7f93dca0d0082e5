"use strict";
// Precision against machine time, a figure for every wanted number.
(() => {
  const { figures } = JSON.parse(document.getElementById("design").textContent);
  const trace = (points, name, rest) => ({
    x: points.map((one) => one.minutes), y: points.map((one) => one.percent), text: points.map((one) => one.name),
    customdata: points.map((one) => one.words), name,
    hovertemplate: "%{text}: %{y:.3g} % in %{x:.4g} min<br>%{customdata}<extra></extra>", ...rest,
  });

  figureBoxes((box) => {
    const { wanted, front, protocols, against } = figures[Number(box.dataset.want)];
    const given = against ? [against] : [];
    const minutes = [...front, ...protocols, ...given].map((one) => one.minutes);
    const ends = [0.9 * Math.min(...minutes), 1.1 * Math.max(...minutes)];
    const line = { mode: "lines+markers", line: { color: colour("data"), width: 2 }, marker: { size: 6 } };
    // the first of the table stands out; numbers would lie on each other
    const sizes = protocols.map((_, rank) => (rank === 0 ? 14 : 8));
    const ranked = { mode: "markers", marker: { color: colour("model"), size: sizes } };
    const star = { mode: "markers", marker: { color: colour("ink"), size: 12, symbol: "star" } };
    return {
      traces: [
        { x: ends, y: [wanted, wanted], mode: "lines", line: { color: colour("soft"), width: 1, dash: "dash" }, name: "wanted", hoverinfo: "skip" },
        trace(front, "least time", line),
        trace(protocols, "protocols", ranked),
        ...given.map((one) => trace([one], one.name, star)),
      ],
      x: "Machine time a specimen [min]", y: "Standard deviation [%]",
      layout: { xaxis: { type: "log" }, yaxis: { type: "log" } },
    };
  });
})();
