"use strict";
// Boxes of figures, for every page that has some: drawn when they come into view, again in other colours,
// and all of them on paper.
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const faint = (name, opacity) => colour(name).replace(/^#(..)(..)(..)$/, (_, r, g, b) => `rgba(${[r, g, b].map((part) => parseInt(part, 16)).join(",")},${opacity})`);
const axis = (title) => ({ title: { text: title }, gridcolor: colour("line"), zerolinecolor: colour("soft"), linecolor: colour("line"), automargin: true });

// `figure(box)` gives traces, the titles x and y of the axes, and a layout that is laid over the common one;
// what comes back draws the wanted ones of those that are drawn again
const figureBoxes = (figure) => {
  const draw = (box) => {
    const { traces, x, y, layout = {} } = figure(box);
    // a grid of small axes brings its own
    const axes = x === undefined ? {} : { xaxis: { ...axis(x), ...layout.xaxis }, yaxis: { ...axis(y), ...layout.yaxis } };
    box.dataset.drawn = "yes";
    return Plotly.react(box, traces, {
      margin: { l: 56, r: 12, t: 28, b: 48 }, paper_bgcolor: colour("paper"), plot_bgcolor: colour("paper"),
      font: { color: colour("ink"), family: "system-ui, sans-serif", size: 13 },
      legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom" }, hovermode: "closest", ...layout, ...axes,
    }, { responsive: true, displaylogo: false, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] });
  };
  const boxes = [...document.querySelectorAll("[data-figure]")];
  const redraw = (wanted = () => true) => boxes.filter((box) => box.dataset.drawn && wanted(box)).forEach(draw);
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (entry.isIntersecting && !entry.target.dataset.drawn) draw(entry.target);
    }
  }, { rootMargin: "300px" });
  boxes.forEach((box) => seen.observe(box));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => redraw());
  matchMedia("print").addEventListener("change", () => redraw());
  addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach((details) => { details.open = true; });
    boxes.forEach(draw);
  });
  return redraw;
};
