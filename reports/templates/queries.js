// The table of queries, made from data as far as it is looked at.

const data = read("data");
if (data && $("q-table")) queryTable(data);

function queryTable({ columns, rows }) {
  const percent = (value) => (value === null ? "–" : (100 * value).toFixed(1));
  const least = (row) => Math.min(...row.values.filter((v) => v !== null));
  const total = (row) => Object.values(row.seconds).reduce((a, b) => a + b, 0);
  const answer = (row) => {
    if (row.absent) return row.found ? "✗ found, but absent" : "✓ “not here”";
    return row.found ? "found" : "✗ “not here”";
  };
  const shown = [
    { title: "query", name: true, key: (r) => r.text },
    { title: "scene", name: true, key: (r) => r.scene },
    { title: "method", name: true, key: (r) => r.method },
    ...columns.map((c, i) => ({
      title: columns.some((o, j) => j !== i && o.title === c.title) ? `${c.title} (${c.protocol})` : c.title,
      key: (r) => r.values[i],
      text: (r) => percent(r.values[i]),
    })),
    { title: "confidence", key: (r) => r.confidence, text: (r) => r.confidence.toFixed(3) },
    { title: "answer", name: true, key: answer },
    { title: "seconds", key: total, text: (r) => total(r).toFixed(2) },
  ];
  const head = $("q-table").tHead.rows[0], body = $("q-table").tBodies[0];
  let sorted = rows.map((row, i) => ({ ...row, i })), current = [], limit = PAGE;

  shown.forEach((column) => {
    const button = make("button", { type: "button" }, column.title);
    const th = make("th", { scope: "col", class: column.name ? "name" : "" , "aria-sort": "none" }, button);
    button.addEventListener("click", () => {
      const keyed = sorted.map((row) => [column.key(row), row]);
      const order = nextOrder(th, !column.name);
      keyed.sort(comparator(order === "ascending" ? 1 : -1));
      sorted = keyed.map(([, row]) => row);
      markSorted(th, order);
      refresh();
    });
    head.append(th);
  });
  for (const [id, field] of [["q-scene", "scene"], ["q-method", "method"]]) {
    const values = [...new Set(rows.map((row) => row[field]))];
    $(id).append(...values.map((value) => make("option", { value }, value)));
  }
  const kinds = {
    missed: (r) => !r.absent && !r.found,
    absent: (r) => r.absent,
    false: (r) => r.absent && r.found,
    low: (r) => least(r) < 0.25,
    high: (r) => least(r) > 0.5 && least(r) <= 1,
  };

  function refresh() {
    const words = $("q-text").value.toLowerCase().split(/\s+/).filter(Boolean);
    const scene = $("q-scene").value, method = $("q-method").value, kind = kinds[$("q-kind").value];
    current = sorted.filter((row) => {
      if (scene && row.scene !== scene) return false;
      if (method && row.method !== method) return false;
      if (kind && !kind(row)) return false;
      const text = `${row.text} ${row.target ?? ""} ${row.query} ${row.dataset}`.toLowerCase();
      return words.every((word) => text.includes(word));
    });
    limit = PAGE;
    body.replaceChildren();
    append(0);
  }

  function append(from) {
    // Only what can be seen soon is in the page: hundreds of rows stay quick.
    body.append(...current.slice(from, limit).map(line));
    const left = current.length - Math.min(limit, current.length);
    $("q-more").hidden = left === 0;
    $("q-more").textContent = `Show ${Math.min(PAGE, left)} more of ${left}`;
    $("q-count").textContent = `${current.length} of ${rows.length} answers`;
  }

  $("q-more").addEventListener("click", () => {
    const from = limit;
    limit += PAGE;
    append(from);
    body.rows[body.rows.length - 1].scrollIntoView({ block: "nearest" });
  });

  function line(row) {
    const tr = make("tr");
    shown.forEach((column, i) => {
      const text = (column.text ?? column.key)(row);
      const td = make("td", { class: column.name ? "name" : "" });
      if (i === 0) {
        const button = make("button", { type: "button", class: "open", title: row.query, "aria-expanded": "false" }, text);
        button.addEventListener("click", () => toggle(tr, button, row));
        td.append(button);
      } else {
        td.textContent = text;
        if (column.name) td.title = text;
      }
      tr.append(td);
    });
    return tr;
  }

  function toggle(tr, button, row) {
    const open = button.getAttribute("aria-expanded") === "true";
    button.setAttribute("aria-expanded", String(!open));
    if (open) {
      tr.nextElementSibling.remove();
      return;
    }
    const td = make("td", { colSpan: shown.length }, evidence(row, columns));
    const detail = make("tr", { class: "detail", id: `detail-${row.i}` }, td);
    button.setAttribute("aria-controls", detail.id);
    tr.after(detail);
    detail.querySelectorAll("canvas").forEach((canvas) => canvas.dispatchEvent(new Event("draw")));
  }

  for (const id of ["q-text", "q-scene", "q-method", "q-kind"]) $(id).addEventListener("input", refresh);
  refresh();
}
