"use strict";
// Figures of a posterior: marginal densities, viscosity against relaxation time, traces of the chains.
const posteriorKinds = (payload, floats, colour) => {
  const opened = new Map();
  const posterior = (specimen) => {
    if (!opened.has(specimen)) {
      const raw = payload.posteriors[specimen];
      const table = (packed) => {
        const all = floats(packed.values);
        return raw.names.map((_, i) => all.subarray(i * packed.count, (i + 1) * packed.count));
      };
      opened.set(specimen, { ...raw, draws: table(raw.draws), total: raw.total && table(raw.total),
        chain: { ...raw.chain, values: floats(raw.chain.values) } });
    }
    return opened.get(specimen);
  };
  const BINS = 28;
  const density = (values, low, high) => {
    const counts = new Array(BINS).fill(0);
    const width = (high - low) / BINS || 1;
    for (const value of values) counts[Math.min(Math.max(Math.floor((value - low) / width), 0), BINS - 1)] += 1;
    return { x: counts.map((_, i) => low + (i + 0.5) * width), y: counts.map((count) => count / (values.length * width)) };
  };
  // a cell of a grid of small axes: plotly numbers its axes from 1 and leaves the 1 away
  const cell = (i) => ({ xaxis: `x${i ? i + 1 : ""}`, yaxis: `y${i ? i + 1 : ""}` });
  const named = (title) => ({ title: { text: title, standoff: 4, font: { size: 11 } }, gridcolor: colour("line"), zeroline: false, automargin: true, tickfont: { size: 10 }, nticks: 4 });
  const columns = (box) => (box.clientWidth < 520 ? 2 : box.clientWidth < 900 ? 3 : 4);
  const grid = (count, wide, extra) => ({ grid: { rows: Math.ceil(count / wide), columns: wide, pattern: "independent", xgap: 0.12, ygap: 0.45 }, showlegend: false, ...extra });

  const marginals = (specimen) => {
    const found = posterior(specimen);
    return found.names.flatMap((_, i) => {
      const wide = (found.total || found.draws)[i];
      const low = wide.reduce((a, b) => Math.min(a, b)), high = wide.reduce((a, b) => Math.max(a, b));
      const line = (values, name, style) => ({ ...density(values, low, high), ...cell(i), mode: "lines", name, ...style,
        hovertemplate: `%{x:.4g}<extra>${name}</extra>` });
      const traces = [line(found.draws[i], "statistical", { fill: "tozeroy", line: { color: colour("model"), width: 1, shape: "hvh" } })];
      if (found.total) traces.push(line(found.total[i], "total", { line: { color: colour("data"), width: 2, shape: "hvh" } }));
      return traces;
    });
  };
  const marginalLayout = (specimen, box) => {
    const found = posterior(specimen), wide = columns(box);
    const layout = grid(found.names.length, wide, {});
    found.labels.forEach((label, i) => {
      layout[`xaxis${i ? i + 1 : ""}`] = named(label);
      layout[`yaxis${i ? i + 1 : ""}`] = { showticklabels: false, showgrid: false, zeroline: false, rangemode: "tozero" };
    });
    return { layout, height: 150 * Math.ceil(found.names.length / wide) + 40 };
  };

  const branches = (found) => ["", "_b2", "_b3"].map((suffix) => [`relaxation_time_s${suffix}`, `viscosity_N_s_per_mm${suffix}`].map((name) => found.names.indexOf(name)))
    .filter(([time, viscosity]) => time >= 0 && viscosity >= 0);
  const pair = (specimen) => {
    const found = posterior(specimen);
    return branches(found).flatMap(([time, viscosity], i) => {
      const dots = (table, name, ink, size) => ({ x: table[time], y: table[viscosity], ...cell(i), mode: "markers", name, legendgroup: name, showlegend: i === 0,
        marker: { color: colour(ink), size, opacity: 0.35 }, hovertemplate: "%{x:.4g}, %{y:.4g}<extra></extra>" });
      const traces = [dots(found.draws, "statistical", "model", 3)];
      if (found.total) traces.unshift(dots(found.total, "total", "data", 4));
      return traces;
    });
  };
  const pairLayout = (specimen, box) => {
    const found = posterior(specimen), all = branches(found), wide = box.clientWidth < 520 ? 1 : all.length;
    const layout = grid(all.length, wide, { showlegend: true });
    all.forEach(([time, viscosity], i) => {
      layout[`xaxis${i ? i + 1 : ""}`] = { ...named(found.labels[time]), type: "log", dtick: undefined };
      layout[`yaxis${i ? i + 1 : ""}`] = named(found.labels[viscosity]);
    });
    return { layout, height: 280 * Math.ceil(all.length / wide) + 40 };
  };

  const trace = (specimen) => {
    const { names, shape: [chains, steps, size], values } = posterior(specimen).chain;
    const inks = ["model", "data", "aside", "ok"];
    return names.flatMap((name, i) => Array.from({ length: chains }, (_, c) => ({
      y: Array.from({ length: steps }, (__, k) => values[(c * steps + k) * size + i]), ...cell(i), mode: "lines",
      line: { color: colour(inks[c % inks.length]), width: 0.8 }, opacity: 0.8, hovertemplate: `${name} %{y:.4g}<extra></extra>` })));
  };
  const traceLayout = (specimen, box) => {
    const { names } = posterior(specimen).chain;
    const wide = box.clientWidth < 520 ? 1 : Math.min(names.length, 3);
    const layout = grid(names.length, wide, {});
    names.forEach((name, i) => {
      layout[`xaxis${i ? i + 1 : ""}`] = { showticklabels: false, showgrid: false, zeroline: false };
      layout[`yaxis${i ? i + 1 : ""}`] = named(name);
    });
    return { layout, height: 120 * Math.ceil(names.length / wide) + 40 };
  };

  return { marginals: { traces: marginals, own: marginalLayout }, pair: { traces: pair, own: pairLayout }, trace: { traces: trace, own: traceLayout } };
};
