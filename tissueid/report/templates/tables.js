"use strict";
// Tables that sort by a click (or Enter) on a heading and filter by a few letters.
const compare = (a, b) => (typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), undefined, { numeric: true }));
// what has no number stands last, whichever way the rest is sorted
const inOrder = (rows, key, down) => {
  const keyed = rows.map((row) => [key(row), row]);
  keyed.sort(([a], [b]) => (a === null || b === null ? (a === null) - (b === null) : (down ? -1 : 1) * compare(a, b)));
  return keyed.map(([, row]) => row);
};
// every heading becomes a button; `sort(column, down)` follows a click on it
const sortable = (table, sort) => {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = element("button", { type: "button" });
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      heads.forEach((one) => one.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      sort(column, down, head.textContent.trim());
    });
  });
};
(() => {
  // "not identified", "–" and the like carry no number
  const value = (cell) => {
    const text = (cell.dataset.value ?? cell.textContent).trim();
    const number = Number(text.replace("−", "-").replace(/,/g, ""));
    return text === "" || text === "–" ? null : Number.isNaN(number) ? text : number;
  };
  document.querySelectorAll("table[data-sorts]").forEach((table) => {
    const body = table.tBodies[0], rows = [...body.rows], said = document.getElementById(table.dataset.sorts);
    const tell = (more = "") => { said.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows${more}`; };
    sortable(table, (column, down, name) => {
      body.append(...inOrder(rows, (row) => value(row.cells[column]), down));
      tell(`, sorted by ${name}, ${down ? "descending" : "ascending"}`);
    });
    const [filter, least] = ["input", "select"].map((kind) => document.querySelector(`${kind}[data-filters="${table.id}"]`));
    const narrow = () => {
      const wanted = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
      rows.forEach((row) => {
        const text = (row.dataset.text ?? row.textContent).toLowerCase();
        row.hidden = (least && Number(row.dataset.level) < Number(least.value)) || !wanted.every((word) => text.includes(word));
        // the part of the page that a row stands for goes with it
        if (row.dataset.row) document.getElementById(row.dataset.row).hidden = row.hidden;
      });
      tell();
    };
    filter.addEventListener("input", narrow);
    least?.addEventListener("change", narrow);
    tell();
  });
  document.querySelectorAll("button[data-copies]").forEach((button) => {
    const before = button.firstChild.textContent;
    button.addEventListener("click", async () => {
      const part = document.getElementById(button.dataset.copies), plain = part.value ?? part.innerText;
      const blob = (type, text) => ({ [type]: new Blob([text], { type }) });
      let told = "copied";
      try {
        const rich = part.value === undefined ? blob("text/html", part.innerHTML) : {};
        await navigator.clipboard.write([new ClipboardItem({ ...blob("text/plain", plain), ...rich })]);
      } catch {
        // a page opened from a file may not be allowed to: it is selected then
        if (part.select) part.select();
        else getSelection().selectAllChildren(part);
        if (!document.execCommand("copy")) told = "selected: press Ctrl-C";
      }
      button.firstChild.textContent = told;
      say(told);
      setTimeout(() => { button.firstChild.textContent = before; }, 3000);
    });
  });
})();
