"use strict";
// The table of a large cohort: sorted, filtered, and drawn a piece at a time; histograms of its numbers.
(() => {
  const PIECE = 200;
  const { rows } = payload;
  const table = document.querySelector("table.overview"), body = table.tBodies[0];
  const [filter, more, told] = ["filter", "more", "shown"].map((id) => document.getElementById(id));
  let order = rows, shown = rows;

  const drawMore = () => {
    for (const row of shown.slice(body.rows.length, body.rows.length + PIECE)) {
      const line = element("tr"), head = element("th", { scope: "row" });
      head.append(element("a", { href: row.page, textContent: row.name }));
      const numbers = row.cells.map((textContent) => element("td", { textContent, className: "num" }));
      line.append(head, element("td", { textContent: row.verdict }), ...numbers);
      body.append(line);
    }
    more.hidden = body.rows.length >= shown.length;
    told.textContent = `${body.rows.length} of ${shown.length} specimens`;
  };
  const redraw = () => {
    const wanted = filter.value.toLowerCase();
    shown = order.filter((row) => row.name.toLowerCase().includes(wanted));
    body.replaceChildren();
    drawMore();
  };
  sortable(table, (column, down) => {
    order = inOrder(rows, (row) => row.keys[column], down);
    redraw();
  });
  filter.addEventListener("input", redraw);
  more.addEventListener("click", drawMore);
  drawMore();

  const words = ["stiffness at contact [N/mm]", "relaxation time [s]", "viscosity [N s/mm]", "NRMSD [% of range]"];
  figureBoxes((box) => {
    const axes = words.map((title, k) => ["", named(title), named(k % 2 ? "" : "specimens")]);
    const layout = panels(box, 2, axes, { bargap: 0.03 });
    const traces = words.map((_, k) => ({
      type: "histogram", x: rows.map((row) => row.keys[k + 2]).filter((value) => value !== null), ...cell(k),
      marker: { color: colour("link") }, nbinsx: 40,
    }));
    return { traces, layout, height: 260 * layout.grid.rows };
  });
})();
