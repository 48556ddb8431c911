"use strict";
// Everything is built with textContent and attributes: names are never read as HTML.
(() => {
  const $ = (id) => document.getElementById(id);
  const SVG = "http://www.w3.org/2000/svg";
  const PAGE = 100;

  function make(tag, properties = {}, ...children) {
    const node = document.createElement(tag);
    for (const [key, value] of Object.entries(properties)) {
      if (key === "class") node.className = value;
      else if (key.includes("-") || key === "role") node.setAttribute(key, value);
      else node[key] = value;
    }
    node.append(...children.filter((child) => child !== null && child !== undefined));
    return node;
  }

  function read(id) {
    const node = $(id);
    return node ? JSON.parse(node.textContent) : null;
  }

  // ---- tables that stand in the page ---------------------------------------------------------

  function comparator(sign) {
    // What has no number comes last, whichever way it is sorted.
    return ([a], [b]) => {
      const emptyA = a === null || a === "–", emptyB = b === null || b === "–";
      if (emptyA || emptyB) return emptyA - emptyB;
      if (typeof a === "number" && typeof b === "number") return sign * (a - b);
      if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
      return sign * a.localeCompare(b, undefined, { numeric: true });
    };
  }

  function nextOrder(th, isNumber) {
    const before = th.getAttribute("aria-sort");
    const first = isNumber ? "descending" : "ascending";
    const other = isNumber ? "ascending" : "descending";
    return before === first ? other : first;
  }

  function markSorted(th, order) {
    for (const head of th.parentElement.children) head.setAttribute("aria-sort", "none");
    th.setAttribute("aria-sort", order);
  }

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

  // ---- the table of queries ------------------------------------------------------------------

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

  // ---- the evidence behind an answer ---------------------------------------------------------

  const blocks = new Map(); // parsed when the first of its queries is opened
  function block(index) {
    if (!blocks.has(index)) blocks.set(index, read(`evidence-${index}`));
    return blocks.get(index);
  }

  const MASK = "#e69f00", TRUTH = "#56b4e9", OTHER = "#c9ccd1", DYE = "#ff0000";

  function shot(picture, outlines, text, dot) {
    const img = make("img", {
      src: `data:image/webp;base64,${picture.webp}`, width: picture.width, height: picture.height, alt: text,
    });
    const frame = make("div", { class: "shot" }, img);
    const svg = document.createElementNS(SVG, "svg");
    svg.setAttribute("viewBox", `0 0 ${picture.width} ${picture.height}`);
    svg.setAttribute("aria-hidden", "true");
    for (const { path, colour, dash } of outlines) {
      if (!path) continue;
      for (const kind of ["casing", "line"]) {
        const node = document.createElementNS(SVG, "path");
        node.setAttribute("d", path);
        node.setAttribute("class", kind + (dash && kind === "line" ? " dash" : ""));
        if (kind === "line") node.setAttribute("stroke", colour);
        svg.append(node);
      }
    }
    if (dot) {
      const node = document.createElementNS(SVG, "circle");
      for (const [key, value] of Object.entries({ cx: dot[0], cy: dot[1], r: 3.5, fill: "#fff", stroke: "#000", "stroke-width": 1.5 }))
        node.setAttribute(key, value);
      svg.append(node);
    }
    frame.append(svg);
    return frame;
  }

  function figure(picture, outlines, caption, text, dot) {
    return make("figure", {}, shot(picture, outlines, text, dot), make("figcaption", {}, ...caption));
  }

  function mark(colour) {
    const node = make("span", { class: "mark" });
    node.style.background = colour;
    return node;
  }

  function step(number, title) {
    return make("h4", {}, `${number}. ${title}`);
  }

  function evidence(row, columns) {
    const box = make("div", { class: "evidence" });
    const bold = make("b", {}, `“${row.text}”`);
    const meant = row.absent ? "not in this scene" : row.target === null ? "nobody knows which object" : `means ${row.target}`;
    const seconds = Object.entries(row.seconds).map(([k, v]) => `${k} ${v.toFixed(2)} s`).join(", ");
    box.append(make("p", {}, bold, ` in ${row.dataset}/${row.scene} by ${row.method}; ${meant}. `
      + `${row.flagged.toLocaleString("en")} Gaussians flagged, ${seconds}.`));
    const all = row.block === null ? null : block(row.block);
    if (!all) {
      box.append(make("p", { class: "note" }, "No pictures of this answer are in this page."));
      return box;
    }
    if (all.plain) {
      const picture = all.plain[row.query];
      if (picture) box.append(make("div", { class: "strip large" }, figure(picture, [], ["The answer red, the truth outlined."], row.text)));
      return box;
    }
    const own = all.queries.find((query) => query.query === row.query);
    if (!own) return box;
    const toggle = make("input", { type: "checkbox", checked: true });
    toggle.addEventListener("input", () => box.classList.toggle("outlines-off", !toggle.checked));
    const key = (colour, text) => make("span", {}, mark(colour), text);
    box.append(make("p", { class: "small key" },
      key(MASK, "patch or mask of a model"), key(OTHER, "patch that supports no place (dashed)"), key(TRUTH, "truth (dashed)"), key(DYE, "the answer"),
      make("label", {}, toggle, " show outlines")));
    let number = 1;
    if (own.votes.length) {
      box.append(step(number++, "Retrieved views, the most relevant first"), retrieved(own, all));
      box.append(step(number++, "Votes in 3D"), votes(own, all));
    } else {
      box.append(make("p", { class: "soft small" }, "Nothing was retrieved: this method has no such step, or no view put a patch forward."));
    }
    const cut = (role) => own.virtual.filter((view) => view.role === role);
    const drawn = (view, name) => figure(
      view, [{ path: view.outline, colour: MASK }],
      [name, view.outline === null ? " · nothing found in it" : ""], `${name} with its mask`);
    const cuts = make("div", { class: "cuts" });
    if (cut("bev").length)
      cuts.append(make("div", { class: "bev" }, step(number++, "Bird’s-eye view and its mask"), ...cut("bev").map((v) => drawn(v, "from above"))));
    if (cut("ring").length)
      cuts.append(make("div", { class: "ring" }, step(number++, "Surrounding views and their masks"),
        make("div", { class: "strip" }, ...cut("ring").map((v, i) => drawn(v, `ring camera ${i + 1}`)))));
    if (cuts.children.length) box.append(cuts);
    if (own.finals.length) {
      const title = own.finals.some((f) => f.test) ? "The answer in the test views" : "The answer";
      const finals = own.finals.map((final) => {
        const caption = [make("b", {}, final.view)];
        const scores = row.views[final.view];
        if (scores) columns.forEach((c, i) => { if (scores[i] !== null) caption.push(` · ${c.title} ${(100 * scores[i]).toFixed(1)}`); });
        else caption.push(final.outline === null ? " · no truth here" : " · not scored");
        return figure(final, [{ path: final.outline, colour: TRUTH, dash: true }], caption, `${row.text}, dyed red, in ${final.view}`);
      });
      box.append(step(number++, title), make("div", { class: "strip large" }, ...finals));
      if (own.n_more_finals) box.append(make("p", { class: "soft small" }, `and ${own.n_more_finals} more test views`));
    }
    return box;
  }

  const FIRST_VIEWS = 8;
  function retrieved(own, all) {
    const top = Math.max(...own.votes.map((vote) => vote.score)), low = Math.min(0, ...own.votes.map((vote) => vote.score));
    const one = (vote) => {
      const camera = all.cameras[vote.view];
      const supports = vote.place >= 0;
      const meter = make("i");
      meter.style.width = `${(100 * (vote.score - low)) / (top - low || 1)}%`;
      const caption = [make("b", {}, vote.score.toFixed(3)), ` ${camera.name} · ${supports ? `✓ place ${vote.place + 1}` : "✗ no place"}`, make("div", { class: "meter" }, meter)];
      return figure(camera.picture, [{ path: vote.outline, colour: supports ? MASK : OTHER, dash: !supports }], caption, `${camera.name} with its retrieved patch`, vote.pixel);
    };
    const strip = make("div", { class: "strip" }, ...own.votes.slice(0, FIRST_VIEWS).map(one));
    const rest = own.votes.slice(FIRST_VIEWS);
    if (!rest.length) return strip;
    const more = make("button", { type: "button", class: "button" }, `Show the other ${rest.length} views`);
    more.addEventListener("click", () => {
      strip.append(...rest.map(one));
      more.parentElement.remove();
    });
    return make("div", {}, strip, make("p", {}, more));
  }

  // ---- votes in 3D ---------------------------------------------------------------------------

  function bytes(text) {
    return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  }

  function cloudOf(all) {
    if (!all.parsedCloud) {
      const raw = new DataView(bytes(all.cloud.points).buffer), colours = bytes(all.cloud.colours);
      const { low, high } = all.cloud;
      all.parsedCloud = Array.from({ length: colours.length / 3 }, (_, i) => ({
        at: [0, 1, 2].map((k) => low[k] + (raw.getUint16(2 * (3 * i + k), true) / 65535) * (high[k] - low[k])),
        colour: `rgb(${colours[3 * i]},${colours[3 * i + 1]},${colours[3 * i + 2]})`,
      }));
    }
    return all.parsedCloud;
  }

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => a.map((x) => x / (Math.hypot(...a) || 1));

  function votes(own, all) {
    const supporters = own.votes.filter((vote) => vote.place === 0).length;
    const places = own.places.length;
    const summary = places
      ? `${supporters} of ${own.votes.length} views support the first place${places > 1 ? `, of ${places}` : ""}.`
      : `${own.votes.length} views put a patch forward, and agree on no place.`;
    const canvas = make("canvas", { width: 960, height: 720, tabIndex: 0, role: "img",
      "aria-label": `Votes in 3D. ${summary} Arrow keys turn the picture, plus and minus zoom.` });
    const cloud = cloudOf(all);
    const up = unit(all.up), one = unit(cross(up, Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0])), two = cross(up, one);
    const middle = own.places.length ? own.places[0].location : [0, 1, 2].map((k) => median(own.votes.map((v) => v.point[k])));
    const reach = median(cloud.map((p) => Math.hypot(...[0, 1, 2].map((k) => p.at[k] - middle[k])))) || 1;
    const eye = [0, 1, 2].map((k) => median(all.cameras.map((c) => c.position[k])) - middle[k]);
    let yaw = Math.atan2(dot(eye, two), dot(eye, one)), pitch = 0.6, zoom = 1.3;

    function draw() {
      const g = canvas.getContext("2d"), { width, height } = canvas;
      const forward = [0, 1, 2].map((k) => -(Math.cos(pitch) * (Math.cos(yaw) * one[k] + Math.sin(yaw) * two[k]) + Math.sin(pitch) * up[k]));
      const right = unit(cross(forward, up)), top = cross(right, forward);
      const scale = (0.3 * height * zoom) / reach;
      const put = (p) => {
        const d = [p[0] - middle[0], p[1] - middle[1], p[2] - middle[2]];
        return [width / 2 + scale * dot(d, right), height / 2 - scale * dot(d, top), dot(d, forward)];
      };
      g.fillStyle = "#14181d";
      g.fillRect(0, 0, width, height);
      g.globalAlpha = 0.8;
      const size = Math.max(4, Math.min(16, 6 * zoom));
      const spots = cloud.map((p) => [put(p.at), p.colour]).sort((a, b) => b[0][2] - a[0][2]);
      for (const [[x, y], colour] of spots) {
        g.fillStyle = colour;
        g.fillRect(x - size / 2, y - size / 2, size, size);
      }
      g.globalAlpha = 1;
      g.lineWidth = 2;
      for (const camera of all.cameras) {
        const [x, y] = put(camera.position);
        g.strokeStyle = "#8fa3b5";
        g.beginPath();
        g.moveTo(x, y - 8); g.lineTo(x + 7, y + 6); g.lineTo(x - 7, y + 6); g.closePath();
        g.stroke();
      }
      for (const vote of [...own.votes].reverse()) {
        const [x, y] = put(vote.point);
        g.beginPath();
        if (vote.place >= 0) {
          g.arc(x, y, 8, 0, 7);
          g.fillStyle = MASK; g.fill();
          g.strokeStyle = "#000"; g.lineWidth = 2; g.stroke();
        } else {
          for (const [ink, wide] of [["#000", 7], ["#ffffff", 3]]) {
            g.strokeStyle = ink; g.lineWidth = wide;
            g.beginPath();
            g.moveTo(x - 7, y - 7); g.lineTo(x + 7, y + 7); g.moveTo(x + 7, y - 7); g.lineTo(x - 7, y + 7);
            g.stroke();
          }
        }
      }
      own.places.forEach((place, i) => {
        const [x, y] = put(place.location);
        for (const [ink, wide] of [["#000", 6], ["#ff5a5a", 3]]) {
          g.strokeStyle = ink; g.lineWidth = wide;
          g.beginPath(); g.arc(x, y, Math.max(13, scale * place.radius), 0, 7); g.stroke();
          g.beginPath(); g.moveTo(x - 18, y); g.lineTo(x + 18, y); g.moveTo(x, y - 18); g.lineTo(x, y + 18); g.stroke();
        }
        g.font = "600 24px system-ui, sans-serif";
        g.lineWidth = 5; g.strokeStyle = "#000"; g.fillStyle = "#fff";
        g.strokeText(String(i + 1), x + 20, y - 14);
        g.fillText(String(i + 1), x + 20, y - 14);
      });
    }

    function turn(dyaw, dpitch) {
      yaw += dyaw;
      pitch = Math.max(-1.5, Math.min(1.5, pitch + dpitch));
      draw();
    }
    function enlarge(factor) {
      zoom = Math.max(0.2, Math.min(12, zoom * factor));
      draw();
    }
    const keys = {
      ArrowLeft: () => turn(-0.15, 0), ArrowRight: () => turn(0.15, 0), ArrowUp: () => turn(0, 0.12), ArrowDown: () => turn(0, -0.12),
      "+": () => enlarge(1.25), "=": () => enlarge(1.25), "-": () => enlarge(0.8),
    };
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons & 1) turn(-event.movementX * 0.008, event.movementY * 0.006);
    });
    canvas.addEventListener("draw", draw);
    const button = (text, label, action) => {
      const node = make("button", { type: "button", class: "button", "aria-label": label }, text);
      node.addEventListener("click", action);
      return node;
    };
    const controls = make("div", { class: "turn" },
      button("⟲", "turn left", () => turn(-0.3, 0)), button("⟳", "turn right", () => turn(0.3, 0)),
      button("from above", "from above", () => { pitch = 1.5; draw(); }), button("from the side", "from the side", () => { pitch = 0.05; draw(); }),
      button("+", "nearer", () => enlarge(1.4)), button("−", "further away", () => enlarge(1 / 1.4)));
    const text = make("div", { class: "small" }, make("p", {}, summary),
      make("p", {}, mark(MASK), "filled: supports a place; white cross: supports none; red ring: a place, as wide as it reaches; triangles: cameras; dots: some of the scene’s Gaussians."));
    own.places.forEach((place, i) => text.append(make("p", {}, `Place ${i + 1}: ${place.location.map((x) => x.toPrecision(3)).join(", ")}, radius ${place.radius.toPrecision(3)}, weight ${place.weight.toPrecision(3)}.`)));
    return make("div", { class: "votes" }, make("div", {}, canvas, controls), text);
  }

  function median(values) {
    const sorted = [...values].sort((a, b) => a - b);
    return sorted[Math.floor(sorted.length / 2)];
  }
})();
