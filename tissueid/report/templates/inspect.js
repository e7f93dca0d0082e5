"use strict";
// Recordings are drawn when they come into view; a click into one sets a number.
(() => {
  const recording = once((id) => {
    const one = payload[id], numbers = (text) => Array.from(floats(text));
    return { ...one, t: numbers(one.t).map((value) => value + one.t0), x: numbers(one.x), f: numbers(one.f) };
  });
  const number = (value) => Number(value.toPrecision(5)).toString();

  // one trace a kind of phase: its stretches, with a hole between them
  const traces = (one, abscissa, ordinate, extra) => {
    const kinds = new Map();
    const covered = one.phases.length ? one.phases : [["approach", 0, one.t.length - 1]];
    covered.forEach(([kind, first, last]) => {
      const line = kinds.get(kind) || { x: [], y: [], text: [], customdata: [] };
      for (let i = first; i <= last; i += 1) {
        line.x.push(one[abscissa][i]); line.y.push(one[ordinate][i]); line.customdata.push([one.t[i], one.x[i]]);
        line.text.push(`${number(one.t[i])} s, ${number(one.x[i])} mm${one.contact ? ` (depth ${number(one.sign * (one.x[i] - one.contact.x))} mm)` : ""}, ${number(one.f[i])} N`);
      }
      line.x.push(null); line.y.push(null); line.text.push(""); line.customdata.push(null);
      kinds.set(kind, line);
    });
    return [...kinds].map(([kind, line]) => ({ ...line, ...extra, name: kind, legendgroup: kind, mode: "lines", connectgaps: false,
      line: { color: colour(kind), width: 2 }, hovertemplate: "%{text}<extra>" + kind + "</extra>" }));
  };
  const upright = (x0, x1, ink, dash, opacity) => x0 === x1
    ? { type: "line", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, line: { color: ink, width: 1.4, dash } }
    : { type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: ink, opacity, line: { width: 0 }, layer: "below" };
  // a line with its name over it
  const mark = (shapes, notes, x, text, dash) => {
    shapes.push(upright(x, x, colour("mark"), dash));
    const font = { size: 11, color: colour("mark") };
    notes.push({ x, xref: "x", y: 1, yref: "paper", yanchor: "bottom", showarrow: false, text, font });
  };

  // titles stand above the legend, axes are those of a recording
  const figure = (traces, shapes, annotations, axes) => ({ traces, layout: {
    margin: { l: 56, r: 12, t: 44, b: 44 }, legend: { orientation: "h", x: 0, y: 1.05, yanchor: "bottom" }, shapes, annotations, ...axes } });
  const plain = (title) => ({ ...axis(title), zerolinecolor: colour("line") });
  const overTime = (one) => {
    const shapes = one.corners.slice(0, 60).map((corner) => upright(corner.t, corner.t, colour("aside"), "dot"));
    const notes = [];
    if (one.contact && one.contact.t) {
      const [at, from, to] = one.contact.t;
      if (to > from) shapes.push(upright(from, to, colour("mark"), "", 0.25));
      mark(shapes, notes, at, "contact", "dash");
    }
    one.events.forEach((event) => mark(shapes, notes, event.t, event.kind, "solid"));
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
      mark(shapes, notes, x, "contact", "dash");
      if (base !== null) shapes.push({ ...level(base, { color: colour("aside"), width: 1, dash: "dot" }), yref: "y" });
    }
    const data = traces(one, "x", "f", { showlegend: true });
    if (one.events.length) {
      data.push({ x: one.events.map((event) => event.x), y: one.events.map((event) => event.f), text: one.events.map((event) => event.kind), mode: "markers+text",
        customdata: one.events.map((event) => [event.t, event.x]), textposition: "top center", marker: { color: ink, size: 9, symbol: "x" }, name: "event", hovertemplate: "%{text}: %{x:.5g} mm, %{y:.5g} N<extra></extra>" });
    }
    return figure(data, shapes, notes, { xaxis: plain("Displacement as recorded [mm]"), yaxis: plain("Force [N]") });
  };

  // a click sets the number of the decision that is open and can be set in that picture: contact by place, the cut by time
  const clicked = (box, point) => {
    const [t, x] = point.customdata;
    const pick = new CustomEvent("pick", { bubbles: true, cancelable: true, detail: { t, x, recording: box.dataset.recording } });
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

  followLinks();
})();
