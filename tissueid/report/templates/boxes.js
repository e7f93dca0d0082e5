"use strict";
// Boxes of figures, for every page that has some: drawn when they come into view, again in other colours,
// all of them on paper, and each saved as SVG.
// what the figures of the page are drawn from
const payload = JSON.parse(document.querySelector('script[type="application/json"]').textContent);
const bytes = (text) => Uint8Array.from(atob(text), (char) => char.charCodeAt(0));
const floats = (text) => new Float32Array(bytes(text).buffer);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const faint = (name, opacity) => colour(name).replace(/^#(..)(..)(..)$/, (_, r, g, b) => `rgba(${[r, g, b].map((part) => parseInt(part, 16)).join(",")},${opacity})`);
const axis = (title) => ({ title: { text: title }, gridcolor: colour("line"), zerolinecolor: colour("soft"), linecolor: colour("line"), automargin: true });
// a function that works out what it gives of each key at its first asking
const once = (make) => {
  const made = new Map();
  return (key) => {
    if (!made.has(key)) made.set(key, make(key));
    return made.get(key);
  };
};
const element = (name, more) => Object.assign(document.createElement(name), more);
// told to those who do not see it
const say = (text) => { document.getElementById("said").textContent = text; };
// straight across the figure at a value of the one axis
const level = (y, line) => ({ type: "line", xref: "paper", x0: 0, x1: 1, y0: y, y1: y, line });

// `figure(box)` gives traces, titles x and y of the axes, a height, and what is laid over the common layout;
// `after(box)` follows each drawing; without `paper` none is saved, and a printer gets what was seen;
// what comes back draws the wanted ones of those that are drawn again
const figureBoxes = (figure, { after = () => {}, paper = true } = {}) => {
  const described = (box) => {
    const { traces, x, y, height, layout = {} } = figure(box);
    if (height) box.style.height = `${height}px`;
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
    Plotly.react(box, data, layout, { responsive: true, displaylogo: false, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] });
    after(box);
  };
  // on white whatever the screen is, at the size it has on the screen
  const save = async (box) => {
    const root = document.documentElement;
    root.classList.add("light");
    const { data, layout } = described(box);
    root.classList.remove("light");
    const { clientWidth: width, clientHeight: height } = box;
    const href = await Plotly.toImage({ data, layout }, { format: "svg", width, height });
    const name = `${document.title} ${box.dataset.figure}`.replace(/[^\p{L}\p{N}]+/gu, "-");
    element("a", { href, download: `${name}.svg` }).click();
  };
  const boxes = [...document.querySelectorAll("[data-figure]")];
  const redraw = (wanted = () => true) => boxes.filter((box) => box.dataset.drawn && wanted(box)).forEach(draw);
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting && !entry.target.dataset.drawn) draw(entry.target);
  }, { rootMargin: "300px" });
  const there = typeof inflated === "undefined" ? Promise.resolve() : inflated;
  there.then(() => boxes.forEach((box) => seen.observe(box)));
  for (const media of ["(prefers-color-scheme: dark)", "print"]) matchMedia(media).addEventListener("change", () => redraw());
  if (!paper) return redraw;
  boxes.forEach((box) => {
    const button = element("button", { type: "button", className: "save", textContent: "SVG" });
    button.setAttribute("aria-label", `SVG of the figure: ${box.dataset.figure}`);
    button.addEventListener("click", () => save(box));
    box.after(button);
  });
  addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach((details) => { details.open = true; });
    boxes.forEach(draw);
  });
  return redraw;
};

// what a link points into is opened, with everything around it
const followLinks = () => {
  const follow = () => {
    const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (let part = target.closest("details"); part; part = part.parentElement.closest("details")) part.open = true;
    target.scrollIntoView();
  };
  addEventListener("hashchange", follow);
  follow();
};
