// Headings become buttons that sort their table; without this, the tables are read as they are.
"use strict";
for (const table of document.querySelectorAll("table")) {
  const heads = table.tHead.rows[0].cells, body = table.tBodies[0];
  if (body.rows.length < 3) continue;
  const first = [...body.rows];
  for (const [column, head] of [...heads].entries()) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    // Browsers leave controls out where they print a heading again on the next page.
    const printed = document.createElement("span");
    printed.className = "printed";
    printed.textContent = head.textContent;
    head.replaceChildren(button, printed);
    button.addEventListener("click", () => {
      const way = { none: "ascending", ascending: "descending", descending: "none" }[head.ariaSort ?? "none"];
      for (const other of heads) other.ariaSort = null;
      if (way !== "none") head.ariaSort = way;
      const value = (row) => parseFloat(row.cells[column].textContent);
      const words = (row) => row.cells[column].textContent;
      const sorted = way === "none" ? first : [...first].sort((a, b) => {
        const [x, y] = [value(a), value(b)];
        // What has no number comes last, whichever way it is sorted.
        if (isNaN(x) !== isNaN(y)) return isNaN(x) ? 1 : -1;
        const order = isNaN(x) ? words(a).localeCompare(words(b)) : x - y;
        return way === "descending" ? -order : order;
      });
      body.append(...sorted);
    });
  }
}
