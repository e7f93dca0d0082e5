"use strict";
// Figures of a posterior: every parameter against every other, traces of the chains.
const posteriorKinds = () => {
  // columns packed in steps of their range
  const columnsOf = ({ low, high, steps }) => {
    const all = new Uint16Array(bytes(steps).buffer), count = all.length / low.length;
    return low.map((from, i) => Float64Array.from(all.subarray(i * count, (i + 1) * count), (step) => from + ((high[i] - from) * step) / 65535));
  };
  const posterior = once((specimen) => {
    const { draws, total, chain, ...raw } = payload.posteriors[specimen];
    const columns = { draws: columnsOf(draws), total: total && columnsOf(total) };
    return { ...raw, ...columns, chain: { ...chain, columns: columnsOf(chain) } };
  });
  const BINS = 28;
  const density = (values, low, high) => {
    const counts = new Array(BINS).fill(0);
    const width = (high - low) / BINS || 1;
    for (const value of values) counts[Math.min(Math.max(Math.floor((value - low) / width), 0), BINS - 1)] += 1;
    return { x: counts.map((_, i) => low + (i + 0.5) * width), y: counts.map((count) => count / (values.length * width)) };
  };
  // draws of two parameters, the total ones first, so that the others lie over them
  const cloud = (specimen, first, second) => {
    if (!payload.posteriors[specimen]) return [];
    const found = posterior(specimen), [a, b] = [first, second].map((name) => found.names.indexOf(name));
    if (a < 0 || b < 0) return [];
    return [["total", found.total], ["statistical", found.draws]].filter(([, table]) => table).map(([name, table]) => ({ name, x: table[a], y: table[b] }));
  };

  // every parameter against every other: the lower triangle, with the densities on its diagonal
  const MOST_CORNERS = 7, DOTS = 250;
  const thin = (values) => { const step = Math.max(values.length / DOTS, 1); return Array.from({ length: Math.min(values.length, DOTS) }, (_, k) => values[Math.floor(k * step)]); };
  const size = (specimen) => Math.min(posterior(specimen).names.length, MOST_CORNERS);
  const places = (n) => Array.from({ length: n }, (_, row) => Array.from({ length: row + 1 }, (__, column) => [row, column])).flat();
  const bare = (label) => label.replace(", not identified", "");
  const corner = (specimen, box) => {
    const found = posterior(specimen), n = size(specimen), layout = { showlegend: false };
    const gap = 0.012, side = (1 - gap * (n - 1)) / n;
    const traces = places(n).flatMap(([row, column], i) => {
      if (row === column) {
        const wide = (found.total || found.draws)[row];
        const low = wide.reduce((a, b) => Math.min(a, b)), high = wide.reduce((a, b) => Math.max(a, b));
        const bars = (values, name, style) => ({ ...density(values, low, high), ...cell(i), mode: "lines", name, ...style, hoverinfo: "skip" });
        return [bars(found.draws[row], "statistical", { fill: "tozeroy", line: { color: colour("model"), width: 1, shape: "hvh" } }),
          ...(found.total ? [bars(found.total[row], "total", { line: { color: colour("data"), width: 2, shape: "hvh" } })] : [])];
      }
      const dots = (table, name, ink) => ({ x: thin(table[column]), y: thin(table[row]), ...cell(i), mode: "markers", name,
        marker: { color: colour(ink), size: 3, opacity: 0.4 }, hovertemplate: "%{x:.4g}, %{y:.4g}<extra></extra>" });
      return [...(found.total ? [dots(found.total, "total", "data")] : []), dots(found.draws, "statistical", "model")];
    });
    places(n).forEach(([row, column], i) => {
      const bottom = row === n - 1, left = column === 0 && row > 0;
      axesOf(layout, i,
        { ...named(bottom ? bare(found.labels[column]) : "", { showticklabels: bottom, nticks: 3, tickangle: 0 }), domain: [column * (side + gap), column * (side + gap) + side], anchor: `y${i ? i + 1 : ""}` },
        { ...named(left ? bare(found.labels[row]) : "", { showticklabels: left, nticks: 3, ...(row === column ? { rangemode: "tozero" } : {}) }), domain: [(n - 1 - row) * (side + gap), (n - 1 - row) * (side + gap) + side], anchor: `x${i ? i + 1 : ""}` });
    });
    return { traces, layout, height: Math.max(Math.min(box.clientWidth, 900), 320) * 0.85 };
  };

  const trace = (specimen, box) => {
    const { names, shape: [chains, steps], columns } = posterior(specimen).chain;
    const inks = ["model", "data", "aside", "ok"];
    const traces = names.flatMap((name, i) => Array.from({ length: chains }, (_, c) => ({
      y: Array.from({ length: steps }, (__, k) => columns[i][c * steps + k]), ...cell(i), mode: "lines",
      line: { color: colour(inks[c % inks.length]), width: 0.8 }, opacity: 0.8, hovertemplate: `${name} %{y:.4g}<extra></extra>` })));
    const plain = { showticklabels: false, showgrid: false, zeroline: false };
    const layout = panels(box, 3, names.map((name) => ["", plain, named(name)]));
    return { traces, layout, height: 120 * layout.grid.rows + 40 };
  };

  return { cloud, kinds: { corner, trace } };
};
