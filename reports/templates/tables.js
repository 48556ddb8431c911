// Tables that stand in the page: sorted by their heads, filtered by words.

for (const table of document.querySelectorAll("table[data-sortable]")) {
  const body = table.tBodies[0];
  const heads = table.tHead.rows[table.tHead.rows.length - 1].cells;
  [...heads].forEach((th, i) => {
    th.querySelector("button").addEventListener("click", () => {
      const keyed = [...body.rows].map((row) => {
        const td = row.cells[i];
        return [td.dataset.v === undefined ? td.textContent : Number(td.dataset.v), row];
      });
      const isNumber = keyed.some(([key]) => typeof key === "number");
      const order = nextOrder(th, isNumber);
      keyed.sort(comparator(order === "ascending" ? 1 : -1));
      body.append(...keyed.map(([, row]) => row));
      markSorted(th, order);
    });
  });
  const filter = table.closest(".table").querySelector("[data-filter]");
  if (filter) {
    const count = table.closest(".table").querySelector(".count");
    const apply = () => {
      const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
      let shown = 0;
      for (const row of body.rows) {
        const text = row.textContent.toLowerCase();
        row.hidden = !words.every((word) => text.includes(word));
        shown += !row.hidden;
      }
      count.textContent = `${shown} of ${body.rows.length} rows`;
    };
    filter.addEventListener("input", apply);
    apply();
  }
}
