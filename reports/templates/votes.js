// The votes of one query in 3D, on a plain canvas.

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
