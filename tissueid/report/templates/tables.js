"use strict";
// Tables that sort by a click (or Enter) on a heading and filter by a few letters.
(() => {
  // "not identified", "–" and the like carry no number: they stand last, whichever way the rest is sorted
  const value = (cell) => {
    const text = (cell.dataset.value ?? cell.textContent).trim();
    const number = Number(text.replace("−", "-").replace(/,/g, ""));
    return text === "" || text === "–" ? null : Number.isNaN(number) ? text : number;
  };
  const compare = (a, b) => (typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), undefined, { numeric: true }));
  document.querySelectorAll("table[data-sorts]").forEach((table) => {
    const body = table.tBodies[0], rows = [...body.rows], said = document.getElementById(table.dataset.sorts);
    const heads = [...table.tHead.rows[0].cells];
    const tell = (more = "") => { said.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows${more}`; };
    const sort = (column) => {
      const down = heads[column].getAttribute("aria-sort") === "ascending";
      heads.forEach((head) => head.removeAttribute("aria-sort"));
      heads[column].setAttribute("aria-sort", down ? "descending" : "ascending");
      const keyed = rows.map((row) => [value(row.cells[column]), row]);
      keyed.sort(([a], [b]) => (a === null || b === null ? (a === null) - (b === null) : (down ? -1 : 1) * compare(a, b)));
      body.append(...keyed.map(([, row]) => row));
      tell(`, sorted by ${heads[column].textContent.trim()}, ${down ? "descending" : "ascending"}`);
    };
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => sort(column));
    });
    const filter = document.querySelector(`input[data-filters="${table.id}"]`);
    filter.addEventListener("input", () => {
      const wanted = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
      rows.forEach((row) => { row.hidden = !wanted.every((word) => row.textContent.toLowerCase().includes(word)); });
      tell();
    });
    tell();
  });
  document.querySelectorAll("button[data-copies]").forEach((button) => {
    button.addEventListener("click", async () => {
      const part = document.getElementById(button.dataset.copies), plain = part.dataset.plain || part.innerText;
      try {
        await navigator.clipboard.write([new ClipboardItem({ "text/html": new Blob([part.innerHTML], { type: "text/html" }), "text/plain": new Blob([plain], { type: "text/plain" }) })]);
        button.textContent = "copied";
      } catch {
        // a page opened from a file may not be allowed to: it is selected then, for Ctrl-C
        getSelection().selectAllChildren(part);
        button.textContent = "selected: press Ctrl-C";
      }
    });
  });
})();
