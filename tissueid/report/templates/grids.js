"use strict";
// Grids of small axes: plotly numbers its axes from 1 and leaves the 1 away.
const cell = (i) => ({ xaxis: `x${i ? i + 1 : ""}`, yaxis: `y${i ? i + 1 : ""}` });
const named = (title, more = {}) => ({ title: { text: title, standoff: 4, font: { size: 11 } }, gridcolor: colour("line"), zerolinecolor: colour("line"), automargin: true, tickfont: { size: 10 }, nticks: 5, ...more });
const decades = (title) => named(title, { type: "log", dtick: undefined });
const axesOf = (layout, i, x, y) => { layout[`xaxis${i ? i + 1 : ""}`] = x; layout[`yaxis${i ? i + 1 : ""}`] = y; };
// the title of a small panel stands over it
const over = (i, text) => ({ xref: `x${i ? i + 1 : ""} domain`, yref: `y${i ? i + 1 : ""} domain`, x: 0, y: 1.02, xanchor: "left", yanchor: "bottom", showarrow: false, text, font: { size: 12 } });
// a grid of `axes`, each [what stands over it, x, y]: so many beside each other, or one in a narrow box
const panels = (box, beside, axes, extra = {}) => {
  const columns = box.clientWidth < 620 ? 1 : Math.min(beside, axes.length);
  const rows = Math.ceil(axes.length / columns);
  const grid = { rows, columns, pattern: "independent", xgap: 0.12, ygap: 0.45 };
  const layout = { grid, showlegend: false, ...extra };
  layout.annotations = axes.flatMap(([title], i) => (title ? [over(i, title)] : []));
  axes.forEach(([, x, y], i) => axesOf(layout, i, x, y));
  return layout;
};
// a band as a closed outline; where it has no number it has no corner
const outline = (x, low, high, more = {}) => {
  const there = Array.from(low, (_, k) => k).filter((k) => Number.isFinite(low[k]) && Number.isFinite(high[k]));
  const back = [...there].reverse();
  return { x: [...there.map((k) => x[k]), ...back.map((k) => x[k])], y: [...there.map((k) => high[k]), ...back.map((k) => low[k])],
    mode: "lines", line: { width: 0 }, fill: "toself", fillcolor: colour("band"), hoverinfo: "skip", name: "band", showlegend: false, ...more };
};
// series are told apart by colour and by dash or mark
const INKS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
const DASHES = ["solid", "dash", "dot", "dashdot", "longdash", "longdashdot"];
const MARKS = ["circle", "square", "diamond", "triangle-up", "cross", "x"];
const nth = (list, i) => list[i % list.length];
