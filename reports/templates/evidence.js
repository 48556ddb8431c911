// The evidence behind an answer, made when its query is opened.

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
