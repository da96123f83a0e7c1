"use strict";
// Tables that sort in place. Without it every page reads as it is, and headings that are links sort on the server.

const value = (row, i) => {
  const cell = row.cells[i];
  const text = cell.dataset.v ?? cell.textContent.trim();
  if (text === "" || text === "\u2013") return null;
  const number = Number(text);
  return Number.isNaN(number) ? text.toLowerCase() : number;
};

function compare(a, b) {
  if (a === null || b === null) return (a === null) - (b === null); // what has no value stands last
  if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
  return typeof a === "number" ? -1 : 1;
}

function sortRows(table, heading) {
  const descending = heading.getAttribute("aria-sort") === "ascending";
  const body = table.tBodies[0];
  const i = heading.cellIndex;
  const rows = [...body.rows].map((row) => [value(row, i), row]);
  rows.sort(([a], [b]) => (descending && a !== null && b !== null ? compare(b, a) : compare(a, b)));
  body.append(...rows.map(([, row]) => row));
  for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
  table.classList.toggle("regrouped", true);
}

function enliven(root) {
  for (const table of root.querySelectorAll("table.sortable")) {
    for (const heading of table.tHead.rows[0].cells) {
      if (heading.classList.contains("choose")) continue;
      const link = heading.querySelector("a");
      if (link) {
        link.addEventListener("click", (event) => {
          if (event.ctrlKey || event.metaKey || event.shiftKey) return;
          event.preventDefault();
          show(link.href, true);
        });
        continue;
      }
      const unit = heading.querySelector("small");
      const button = document.createElement("button");
      button.type = "button";
      button.append(...[...heading.childNodes].filter((node) => node !== unit));
      heading.prepend(button);
      button.addEventListener("click", () => sortRows(table, heading));
    }
  }
}

const withoutFragment = (address) => address.split("#")[0];
let shown = withoutFragment(location.href);

// The part of a page that its address changes, taken from the server and put in the place of what is shown.
async function show(address, remember) {
  shown = withoutFragment(address);
  try {
    const answer = await fetch(address, { headers: { Accept: "text/html" } });
    if (!answer.ok) throw new Error(answer.statusText);
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    const next = page.getElementById("board");
    const old = document.getElementById("board");
    if (!next || !old) throw new Error("no board");
    const focused = document.activeElement?.closest?.("th")?.cellIndex;
    const scrolled = old.querySelector(".scroll")?.scrollLeft ?? 0;
    old.replaceWith(next);
    enliven(next);
    const region = next.querySelector(".scroll");
    if (region) region.scrollLeft = scrolled;
    if (focused !== undefined) next.querySelectorAll("thead th")[focused]?.querySelector("a")?.focus();
    document.querySelector("footer.site")?.replaceWith(page.querySelector("footer.site"));
    if (remember) history.pushState({ board: true }, "", address);
  } catch {
    location.assign(address);
  }
}

// Also what leads to a place within the page pops a state; the board stays then, and with it what has the focus.
window.addEventListener("popstate", () => {
  if (withoutFragment(location.href) === shown) return;
  if (document.getElementById("board")) show(location.href, false);
});
enliven(document);
