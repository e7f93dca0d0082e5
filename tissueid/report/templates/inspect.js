"use strict";
// Recordings are drawn when they come into view; entries are copied; the index is filtered.
(() => {
  const opened = new Map();
  const recording = (id) => {
    if (!opened.has(id)) {
      const one = payload[id], numbers = (text) => Array.from(floats(text));
      opened.set(id, { ...one, t: numbers(one.t).map((value) => value + one.t0), x: numbers(one.x), f: numbers(one.f) });
    }
    return opened.get(id);
  };
  const number = (value) => Number(value.toPrecision(5)).toString();

  // one trace a kind of phase: its stretches, with a hole between them
  const traces = (one, abscissa, ordinate, extra) => {
    const kinds = new Map();
    const covered = one.phases.length ? one.phases : [["approach", 0, one.t.length - 1]];
    covered.forEach(([kind, first, last]) => {
      const line = kinds.get(kind) || { x: [], y: [], text: [] };
      for (let i = first; i <= last; i += 1) {
        line.x.push(one[abscissa][i]); line.y.push(one[ordinate][i]);
        line.text.push(`${number(one.t[i])} s, ${number(one.x[i])} mm${one.contact ? ` (depth ${number(one.sign * (one.x[i] - one.contact.x))} mm)` : ""}, ${number(one.f[i])} N`);
      }
      line.x.push(null); line.y.push(null); line.text.push("");
      kinds.set(kind, line);
    });
    return [...kinds].map(([kind, line]) => ({ ...line, ...extra, name: kind, legendgroup: kind, mode: "lines", connectgaps: false,
      line: { color: colour(kind), width: 2 }, hovertemplate: "%{text}<extra>" + kind + "</extra>" }));
  };
  const upright = (x0, x1, ink, dash, opacity) => x0 === x1
    ? { type: "line", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, line: { color: ink, width: 1.4, dash } }
    : { type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: ink, opacity, line: { width: 0 }, layer: "below" };
  const label = (x, text, y, ink) => ({ x, xref: "x", y, yref: "paper", yanchor: "bottom", showarrow: false, text, font: { size: 11, color: ink } });

  // titles stand above the legend, axes are those of a recording
  const figure = (traces, shapes, annotations, axes) => ({ traces, layout: {
    margin: { l: 56, r: 12, t: 44, b: 44 }, legend: { orientation: "h", x: 0, y: 1.05, yanchor: "bottom" }, shapes, annotations, ...axes } });
  const plain = (title) => ({ ...axis(title), zerolinecolor: colour("line") });
  const overTime = (one) => {
    const ink = colour("mark");
    const shapes = one.corners.slice(0, 60).map((corner) => upright(corner.t, corner.t, colour("aside"), "dot"));
    const notes = [];
    if (one.contact && one.contact.t) {
      const [at, from, to] = one.contact.t;
      if (to > from) shapes.push(upright(from, to, ink, "", 0.25));
      shapes.push(upright(at, at, ink, "dash"));
      notes.push(label(at, "contact", 1, ink));
    }
    one.events.forEach((event) => {
      shapes.push(upright(event.t, event.t, ink, "solid"));
      notes.push(label(event.t, event.kind, 1, ink));
    });
    const force = traces(one, "t", "f", { xaxis: "x", yaxis: "y", showlegend: true });
    const motion = traces(one, "t", "x", { xaxis: "x", yaxis: "y2", showlegend: false });
    return figure([...force, ...motion], shapes, notes, {
      xaxis: { ...plain("Time as recorded [s]"), anchor: "y2" },
      yaxis: { ...plain("Force [N]"), domain: [0.46, 1] },
      yaxis2: { ...plain("Displacement [mm]"), domain: [0, 0.4] },
    });
  };
  const overDepth = (one) => {
    const ink = colour("mark"), shapes = [], notes = [];
    if (one.contact) {
      const { x, sd, base } = one.contact;
      if (sd > 0) shapes.push(upright(x - sd, x + sd, ink, "", 0.25));
      shapes.push(upright(x, x, ink, "dash"));
      notes.push(label(x, "contact", 1, ink));
      if (base !== null) shapes.push({ ...level(base, { color: colour("aside"), width: 1, dash: "dot" }), yref: "y" });
    }
    const data = traces(one, "x", "f", { showlegend: true });
    if (one.events.length) {
      data.push({ x: one.events.map((event) => event.x), y: one.events.map((event) => event.f), text: one.events.map((event) => event.kind), mode: "markers+text",
        textposition: "top center", marker: { color: ink, size: 9, symbol: "x" }, name: "event", hovertemplate: "%{text}: %{x:.5g} mm, %{y:.5g} N<extra></extra>" });
    }
    return figure(data, shapes, notes, { xaxis: plain("Displacement as recorded [mm]"), yaxis: plain("Force [N]") });
  };
  const say = (text) => { document.getElementById("said").textContent = text; };

  // the sample that was clicked, by its place in the picture
  const nearest = (one, figure, point) => {
    const span = (values) => values.reduce((most, value) => Math.max(most, Math.abs(value - values[0])), 1e-12);
    const [across, up] = figure === "time" ? [one.t, null] : [one.x, one.f];
    const [wide, high] = [span(across), span(up || across)];
    let best = 0;
    let least = Infinity;
    across.forEach((value, i) => {
      const far = Math.abs(value - point.x) / wide + (up ? Math.abs(up[i] - point.y) / high : 0);
      if (far < least) { least = far; best = i; }
    });
    return { t: one.t[best], x: one.x[best] };
  };

  // a click sets the number of the decision that is open and can be set in that picture: contact by place, the cut by time
  const clicked = (box, point) => {
    const one = recording(box.dataset.recording);
    const pick = new CustomEvent("pick", { bubbles: true, cancelable: true, detail: { ...nearest(one, box.dataset.figure, point), recording: box.dataset.recording } });
    if (!box.dispatchEvent(pick)) return;
    const wanted = box.dataset.figure === "time" ? "start_s" : "contact_mm";
    const entry = document.querySelector(`textarea[data-adjust="${wanted}"][id^="${box.dataset.recording}-"]`);
    if (!entry) return;
    entry.closest("details").open = true;
    entry.value = entry.value.replace(new RegExp(`^${wanted} = .*$`, "m"), `${wanted} = ${Number(point.x.toPrecision(7))}`);
    say(`${wanted} set to ${number(point.x)}`);
  };

  figureBoxes((box) => (box.dataset.figure === "time" ? overTime : overDepth)(recording(box.dataset.recording)), { paper: false, after: (box) => {
    box.removeAllListeners("plotly_click");
    box.on("plotly_click", (event) => clicked(box, event.points[0]));
  } });

  document.addEventListener("click", (event) => {
    const button = event.target.closest("button[data-copy]");
    if (!button) return;
    const entry = document.getElementById(button.dataset.copy);
    const done = () => { button.firstChild.textContent = "Copied"; say("copied"); setTimeout(() => { button.firstChild.textContent = "Copy"; }, 1500); };
    const byHand = () => { entry.focus(); entry.select(); if (document.execCommand("copy")) done(); };
    if (navigator.clipboard && window.isSecureContext) navigator.clipboard.writeText(entry.value).then(done, byHand); else byHand();
  });

  const text = document.getElementById("filter-text");
  if (text) {
    const least = document.getElementById("filter-level");
    const rows = [...document.querySelectorAll("[data-row]")];
    const filter = () => {
      const words = text.value.toLowerCase().split(/\s+/).filter(Boolean);
      let shown = 0;
      rows.forEach((row) => {
        const fits = Number(row.dataset.level) >= Number(least.value) && words.every((word) => row.dataset.text.includes(word));
        row.hidden = !fits;
        document.getElementById(row.dataset.row).hidden = !fits;
        shown += fits;
      });
      document.getElementById("filter-count").textContent = `${shown} of ${rows.length}`;
    };
    text.addEventListener("input", filter);
    least.addEventListener("change", filter);
  }
  followLinks();
})();
