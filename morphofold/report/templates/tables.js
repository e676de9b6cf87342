// Tables that sort by a click on a column heading and can be saved as tab-separated text; short ones are opened for printing.
"use strict";
// As in tables on disk: no tabs or line breaks; formulas, quotation marks and n/a only after an apostrophe.
const text = (words) => words.replace(/[\u0000-\u001f\u007f-\u009f\u2028\u2029]/g, " ").replace(/^'*([=+\-@"]|n\/a$)/, "'$&");
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.querySelectorAll("thead th")], body = table.tBodies[0];
  const value = (row, k) => row.cells[k].dataset.v ?? row.cells[k].textContent.trim();
  const compare = (a, b) => {
    const x = Number(a), y = Number(b);
    if (a === "" || b === "") return (a === "") - (b === "");           // missing values come last in both orders
    return Number.isNaN(x) || Number.isNaN(y) ? a.localeCompare(b) : x - y;
  };
  heads.forEach((head, k) => {
    const button = document.createElement("button");
    button.type = "button"; button.className = "sort"; button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const falling = head.getAttribute("aria-sort") === "ascending";
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", falling ? "descending" : "ascending");
      const rows = [...body.rows].sort((p, q) => {
        const order = compare(value(p, k), value(q, k)), missing = value(p, k) === "" || value(q, k) === "";
        return falling && !missing ? -order : order;
      });
      body.append(...rows);
    });
  });
  const save = document.createElement("button");
  save.type = "button"; save.className = "save"; save.textContent = "Save as TSV";
  save.addEventListener("click", () => {
    const number = (row, k) => "v" in row.cells[k].dataset && !Number.isNaN(Number(value(row, k)));
    const lines = [heads.map((h) => text(h.dataset.key || h.textContent.trim())), ...[...body.rows].map((r) =>
      heads.map((_, k) => value(r, k) === "" ? "n/a" : number(r, k) ? value(r, k) : text(value(r, k))))];
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([lines.map((l) => l.join("\t")).join("\n") + "\n"], { type: "text/tab-separated-values" }));
    link.download = table.dataset.name + ".tsv";
    link.click();
    URL.revokeObjectURL(link.href);
  });
  table.after(save);
}
const PRINTED = 60, shut = new Set();            // rows; tables opened for printing only
window.addEventListener("beforeprint", () => {
  for (const details of document.querySelectorAll("details:not([open])"))
    if (details.querySelectorAll("tbody tr").length <= PRINTED) { details.open = true; shut.add(details); }
});
window.addEventListener("afterprint", () => {
  for (const details of shut) details.open = false;
  shut.clear();
});
for (const button of document.querySelectorAll("[data-copy]")) button.addEventListener("click", async () => {
  const text = document.getElementById(button.dataset.copy);
  text.focus(); text.select();
  try { await navigator.clipboard.writeText(text.value); button.textContent = "Copied"; }
  catch { button.textContent = "Selected: press Ctrl+C"; }
});
document.documentElement.dataset.tables = "ready";
