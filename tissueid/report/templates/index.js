"use strict";
// The table of a large cohort: sorted, filtered, and drawn a piece at a time.
(() => {
  const PIECE = 200;
  const { rows } = payload;
  const body = document.querySelector("#cohort tbody");
  const columns = [
    (row) => row.name, (row) => row.verdict,
    (row) => row.values[0], (row) => row.values[1], (row) => row.values[2],
    (row) => row.nrmsd, (row) => row.trials, (row) => row.depth,
  ];
  let order = rows.slice();
  let sorted = { column: -1, down: false };
  let drawn = 0;

  const digits = (value, error) => {
    if (value === null) return "not identified";
    return error > 0 ? `${value.toPrecision(4)} ± ${error.toPrecision(2)}` : value.toPrecision(4);
  };

  const element = (name, more) => Object.assign(document.createElement(name), more);
  const drawMore = () => {
    for (const row of order.slice(drawn, drawn + PIECE)) {
      const line = element("tr"), head = element("th", { scope: "row" });
      head.append(element("a", { href: row.page, textContent: row.name }));
      const numbers = [...row.values.map((value, k) => digits(value, row.errors[k])), row.nrmsd.toFixed(2), String(row.trials), row.depth.toPrecision(3)];
      line.append(head, element("td", { textContent: row.verdict }), ...numbers.map((textContent) => element("td", { textContent, className: "num" })));
      body.append(line);
    }
    drawn = Math.min(drawn + PIECE, order.length);
    document.getElementById("more").hidden = drawn >= order.length;
    document.getElementById("shown").textContent = `${drawn} of ${order.length} specimens`;
  };

  const redraw = () => {
    const wanted = document.getElementById("filter").value.toLowerCase();
    order = rows.filter((row) => row.name.toLowerCase().includes(wanted));
    if (sorted.column >= 0) {
      const key = columns[sorted.column];
      // what is not identified stands last, whichever way the rest is sorted
      order.sort((a, b) => {
        const [x, y] = [key(a), key(b)];
        if (x === null || y === null) return (x === null) - (y === null);
        const sign = sorted.down ? -1 : 1;
        return sign * (typeof x === "string" ? x.localeCompare(y, undefined, { numeric: true }) : x - y);
      });
    }
    body.replaceChildren();
    drawn = 0;
    drawMore();
  };

  document.querySelectorAll("button.sort").forEach((button) => {
    button.addEventListener("click", () => {
      const column = Number(button.dataset.column);
      sorted = { column, down: sorted.column === column && !sorted.down };
      document.querySelectorAll("#cohort thead th").forEach((head, k) => {
        if (k === column) head.setAttribute("aria-sort", sorted.down ? "descending" : "ascending");
        else head.removeAttribute("aria-sort");
      });
      redraw();
    });
  });
  document.getElementById("filter").addEventListener("input", redraw);
  document.getElementById("more").addEventListener("click", drawMore);
  redraw();

  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  const text = dark ? "#e8e8e8" : "#222222";
  const words = ["stiffness at contact [N/mm]", "relaxation time [s]", "viscosity [N s/mm]", "NRMSD [% of range]"];
  const shown = words.map((title, k) => [title, columns[k + 2]]);
  const traces = shown.map(([, key], k) => ({
    type: "histogram",
    x: rows.map(key).filter((value) => value !== null),
    xaxis: `x${k + 1}`, yaxis: `y${k + 1}`, marker: { color: "#3b7dbd" }, nbinsx: 40,
  }));
  const layout = {
    grid: { rows: 2, columns: 2, pattern: "independent", ygap: 0.35 },
    height: 520, showlegend: false, bargap: 0.03,
    margin: { l: 48, r: 12, t: 12, b: 48 },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: text },
  };
  shown.forEach(([title], k) => {
    layout[`xaxis${k + 1}`] = { title: { text: title } };
    layout[`yaxis${k + 1}`] = { title: { text: k % 2 ? "" : "specimens" } };
  });
  Plotly.newPlot("histograms", traces, layout, { displayModeBar: false, responsive: true });
})();
