"use strict";
// Boxes of figures, for every page that has some: drawn when they come into view, again in other colours,
// all of them on paper, and each saved as SVG.
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const faint = (name, opacity) => colour(name).replace(/^#(..)(..)(..)$/, (_, r, g, b) => `rgba(${[r, g, b].map((part) => parseInt(part, 16)).join(",")},${opacity})`);
const axis = (title) => ({ title: { text: title }, gridcolor: colour("line"), zerolinecolor: colour("soft"), linecolor: colour("line"), automargin: true });

// `figure(box)` gives traces, the titles x and y of the axes, and a layout that is laid over the common one;
// what comes back draws the wanted ones of those that are drawn again
const figureBoxes = (figure) => {
  const described = (box) => {
    const { traces, x, y, layout = {} } = figure(box);
    // a grid of small axes brings its own
    const axes = x === undefined ? {} : { xaxis: { ...axis(x), ...layout.xaxis }, yaxis: { ...axis(y), ...layout.yaxis } };
    return { data: traces, layout: {
      margin: { l: 56, r: 12, t: 28, b: 48 }, paper_bgcolor: colour("paper"), plot_bgcolor: colour("paper"),
      font: { color: colour("ink"), family: "system-ui, sans-serif", size: 13 },
      legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom" }, hovermode: "closest", ...layout, ...axes,
    } };
  };
  const draw = (box) => {
    const { data, layout } = described(box);
    box.dataset.drawn = "yes";
    return Plotly.react(box, data, layout, { responsive: true, displaylogo: false, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] });
  };
  // on white whatever the screen is, at the size it has on the screen
  const save = async (box) => {
    const root = document.documentElement;
    root.classList.add("light");
    const { data, layout } = described(box);
    root.classList.remove("light");
    const link = document.createElement("a");
    link.href = await Plotly.toImage({ data, layout }, { format: "svg", width: box.clientWidth, height: box.clientHeight });
    link.download = `${document.title} ${box.dataset.figure}`.replace(/[^\p{L}\p{N}]+/gu, "-") + ".svg";
    link.click();
  };
  const boxes = [...document.querySelectorAll("[data-figure]")];
  boxes.forEach((box) => {
    const button = document.createElement("button");
    Object.assign(button, { type: "button", className: "save", textContent: "SVG" });
    button.setAttribute("aria-label", `SVG of the figure: ${box.dataset.figure}`);
    button.addEventListener("click", () => save(box));
    box.after(button);
  });
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
