// Camera poses from above, over the batch's ground.

const SERIES = ["#3b7dd8", "#d9822b", "#2e9e6b", "#b0468f", "#7a6fd0", "#c23b3b", "#5b8a9a", "#9a8a2e"];
const mapView = { batch: 0, zoom: 1, x: 0, y: 0, ground: null, objects: null, site: null, layer: "relief", picture: null, poses: [], near: null };

async function loadGround(batch) {
  const element = $(`g${batch}`);
  if (!element) return null;
  const text = element.content.textContent;
  const end = text.indexOf("\n");
  const facts = JSON.parse(text.slice(0, end));
  const layer = await decoders.steps(bytesOf(text.slice(end + 1)), facts, { stored: facts.size });
  const heights = Float64Array.from(layer.codes, (_, i) => facts.low + layer.at(i));
  return { ...facts, heights };
}

/** The largest objects: x, y and radius, each in a row. */
async function loadObjects(batch) {
  const element = $(`o${batch}`);
  if (!element) return null;
  const text = element.content.textContent;
  const end = text.indexOf("\n");
  const facts = JSON.parse(text.slice(0, end));
  const raw = await inflate(bytesOf(text.slice(end + 1)));
  return { ...facts, values: new Float32Array(raw.buffer) };
}

async function loadSite(batch) {
  const element = $(`s${batch}`);
  if (!element) return null;
  const text = element.content.textContent;
  const end = text.indexOf("\n");
  return siteOf(JSON.parse(text.slice(0, end)), await inflate(bytesOf(text.slice(end + 1))));
}

/** Shaded from the northwest, 45° high; tinted by height, calm enough to draw upon, or plain. */
function shade(ground, plain = false) {
  const [nx, ny] = ground.size;
  const canvas = new OffscreenCanvas(nx, ny);
  const image = new ImageData(nx, ny);
  const z = ground.heights;
  let low = Infinity;
  let high = -Infinity;
  for (const v of z) if (Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
  const at = (x, y, otherwise) => {
    const v = z[Math.min(ny - 1, Math.max(0, y)) * nx + Math.min(nx - 1, Math.max(0, x))];
    return Number.isFinite(v) ? v : otherwise;
  };
  let slopes = 0;
  for (let i = 1; i < z.length; i += 7) if (Number.isFinite(z[i] - z[i - 1])) slopes = Math.max(slopes, Math.abs(z[i] - z[i - 1]) / ground.step[0]);
  // Flat land is exaggerated until its relief can be seen.
  const steep = Math.min(8, Math.max(1, 1 / (slopes || 1)));
  for (let y = 0; y < ny; y++) {
    for (let x = 0; x < nx; x++) {
      const v = z[y * nx + x];
      const o = 4 * ((ny - 1 - y) * nx + x);
      if (!Number.isFinite(v)) continue;
      const dx = (steep * (at(x + 1, y, v) - at(x - 1, y, v))) / (2 * ground.step[0]);
      const dy = (steep * (at(x, y + 1, v) - at(x, y - 1, v))) / (2 * ground.step[1]);
      const lit = Math.max(0, (0.5 * dx - 0.5 * dy + 0.7071) / Math.hypot(dx, dy, 1));
      const t = high > low ? (v - low) / (high - low) : 0.5;
      const tint = plain ? [1, 1, 1] : [0.52 + 0.3 * t, 0.55 + 0.24 * t, 0.5 + 0.2 * t];
      for (let k = 0; k < 3; k++) image.data[o + k] = 255 * Math.min(1, tint[k] * (0.35 + 0.9 * lit));
      image.data[o + 3] = 255;
    }
  }
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

async function showMap(batch = mapView.batch) {
  mapView.batch = batch;
  Object.assign(mapView, { zoom: 1, x: 0, y: 0, near: null });
  const seen = new Set();
  mapView.poses = frames.filter((f) => {
    const key = `${f.camera}/${f.sample}`;
    if (f.batch !== batch || !f.eye || f.eye.some((v) => v == null) || seen.has(key)) return false;
    if (state.filter.camera !== "" && f.camera !== +state.filter.camera) return false;
    return seen.add(key);
  });
  const [ground, objects, site] = await Promise.all([loadGround(batch), loadObjects(batch), loadSite(batch)]);
  if (mapView.batch !== batch) return;
  Object.assign(mapView, { ground, objects, site });
  paintMap();
  mapBar();
  mapSide();
  drawMap();
}

/** The ground as it is shown: its relief, or a layer of what it is to a vehicle, shaded by it. */
function paintMap() {
  const { ground, site } = mapView;
  const layer = site?.layers.find((one) => one.name === mapView.layer);
  mapView.picture = ground ? shade(ground, Boolean(layer)) : null;
  mapView.colors = ground && layer ? sitePicture(site, layer) : null;
}

function mapLayers() {
  const { site } = mapView;
  if (!site) return "";
  const chosen = site.layers.find((one) => one.name === mapView.layer);
  const choose = (e) => { mapView.layer = e.target.value; paintMap(); mapBar(); drawMap(); };
  const title = chosen?.vehicle ? Object.entries(chosen.vehicle).map(([name, value]) => `${name} ${brief(value)}`).join(", ") : "";
  return make("div.keys", { id: "map-legend", title },
    make("label", {}, "Ground ", make("select", { "aria-label": "Ground", onchange: choose },
      ...["relief", ...site.layers.map((one) => one.name)].map((name) => make("option", { value: name, selected: name === mapView.layer }, name)))),
    ...(chosen ? chosen.names.map((name, i) => {
      const dot = make("i.swatch");
      dot.style.background = css(chosen.colors[i]);
      return make("span", {}, dot, name);
    }) : []),
    chosen?.vehicle ? make("span.hint", {}, `cells of ${brief(site.cell)} m, the worst of ${brief(site.step)} m is shown`) : "");
}

function mapBar() {
  const cameras = [...new Set(mapView.poses.map((f) => f.camera))];
  $("map-bar").replaceChildren(
    make("label", {}, "Batch ", make("select", { "aria-label": "Batch", onchange: (e) => showMap(+e.target.value) },
      ...index.batches.map((name, i) => make("option", { value: i, selected: i === mapView.batch }, name)))),
    make("div.keys", {}, ...cameras.map((camera) => {
      const dot = make("i.swatch");
      dot.style.background = SERIES[camera % SERIES.length];
      return make("span", {}, dot, index.cameras[camera]);
    })),
    mapLayers(),
    mapView.objects?.count ? make("span.hint", {}, mapView.objects.count === mapView.objects.all ? `${count(mapView.objects.all)} objects`
      : `the ${count(mapView.objects.count)} largest of ${count(mapView.objects.all)} objects`) : "",
    make("span.hint", {}, mapView.ground ? "hover: select · click: open · wheel: zoom · drag: move"
      : "no stage was read for this batch: poses only"));
}

/** The part of the world that is shown: ground and poses. */
function mapBounds() {
  const xs = mapView.poses.map((f) => f.eye[0]);
  const ys = mapView.poses.map((f) => f.eye[1]);
  const g = mapView.ground;
  if (g) {
    xs.push(g.corner[0] - g.step[0] / 2, g.corner[0] + (g.size[0] - 0.5) * g.step[0]);
    ys.push(g.corner[1] - g.step[1] / 2, g.corner[1] + (g.size[1] - 0.5) * g.step[1]);
  }
  if (!xs.length) return [-1, -1, 1, 1];
  let box = [lowest(xs), lowest(ys), highest(xs), highest(ys)];
  const pad = g ? 0 : 0.1 * Math.max(box[2] - box[0], box[3] - box[1], 1);
  return [box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad];
}

function mapScale() {
  const canvas = $("map-canvas");
  const [x0, y0, x1, y1] = mapBounds();
  const [w, h] = [canvas.clientWidth, canvas.clientHeight];
  const scale = Math.min((w - 40) / (x1 - x0 || 1), (h - 40) / (y1 - y0 || 1)) * mapView.zoom;
  const ox = w / 2 - (scale * (x0 + x1)) / 2 + mapView.x;
  const oy = h / 2 + (scale * (y0 + y1)) / 2 + mapView.y;
  return { scale, to: (x, y) => [ox + scale * x, oy - scale * y], from: (u, v) => [(u - ox) / scale, (oy - v) / scale] };
}

function drawMap() {
  const canvas = $("map-canvas");
  const ratio = window.devicePixelRatio || 1;
  if (!canvas.clientWidth) return;
  canvas.width = Math.round(canvas.clientWidth * ratio);
  canvas.height = Math.round(canvas.clientHeight * ratio);
  const c = canvas.getContext("2d");
  c.scale(ratio, ratio);
  const { scale, to } = mapScale();
  const g = mapView.ground;
  if (mapView.picture) {
    const [u, v] = to(g.corner[0] - g.step[0] / 2, g.corner[1] + (g.size[1] - 0.5) * g.step[1]);
    c.imageSmoothingEnabled = scale * g.step[0] < 6;
    const s = mapView.colors && mapView.site;
    if (s) {
      // Where nothing is known the page's own color stays.
      const [a, b] = to(s.corner[0] - s.cell / 2, s.corner[1] - s.cell / 2 + s.size[1] * s.step);
      c.imageSmoothingEnabled = false;
      c.drawImage(mapView.colors, a, b, scale * s.size[0] * s.step, scale * s.size[1] * s.step);
      c.imageSmoothingEnabled = scale * g.step[0] < 6;
      c.globalCompositeOperation = "multiply";
    }
    c.drawImage(mapView.picture, u, v, scale * g.size[0] * g.step[0], scale * g.size[1] * g.step[1]);
    c.globalCompositeOperation = "source-over";
  }
  const style = getComputedStyle(document.body);
  drawObjects(c, to, scale);
  drawTracks(c, to);
  const length = Math.min(46, Math.max(16, 0.05 * Math.min(canvas.clientWidth, canvas.clientHeight)));
  const labels = [];
  // The one that is chosen comes last, and narrow views lie over wide ones.
  const order = [...mapView.poses].sort((a, b) => (a.number === state.selected) - (b.number === state.selected) || (b.half ?? 0) - (a.half ?? 0));
  for (const f of order) drawPose(c, to, f, length, labels, style);
  scaleBar(c, scale, canvas.clientHeight, style);
}

function drawObjects(c, to, scale) {
  const objects = mapView.objects;
  if (!objects) return;
  const n = objects.count;
  c.beginPath();
  for (let i = 0; i < n; i++) {
    const [u, v] = to(objects.values[i], objects.values[n + i]);
    const r = Math.max(0.6, scale * objects.values[2 * n + i]);
    c.moveTo(u + r, v);
    c.arc(u, v, r, 0, 2 * Math.PI);
  }
  c.fillStyle = "#3a2c2480";
  c.fill();
}

/** Samples in order, where they are a path: steps short against its extent. */
function drawTracks(c, to) {
  for (const camera of new Set(mapView.poses.map((f) => f.camera))) {
    const path = mapView.poses.filter((f) => f.camera === camera);
    if (path.length < 3) continue;
    const lengths = path.slice(1).map((f, i) => Math.hypot(f.eye[0] - path[i].eye[0], f.eye[1] - path[i].eye[1])).sort((a, b) => a - b);
    const xs = path.map((f) => f.eye[0]);
    const ys = path.map((f) => f.eye[1]);
    const extent = Math.hypot(highest(xs) - lowest(xs), highest(ys) - lowest(ys));
    if (lengths[Math.floor(lengths.length / 2)] > 0.2 * extent) continue;
    c.beginPath();
    for (const f of path) c.lineTo(...to(f.eye[0], f.eye[1]));
    c.strokeStyle = "#fffc";
    c.lineWidth = 3.5;
    c.stroke();
    c.strokeStyle = SERIES[camera % SERIES.length];
    c.lineWidth = 1.5;
    c.stroke();
  }
}

function drawPose(c, to, f, length, labels, style) {
  const [u, v] = to(f.eye[0], f.eye[1]);
  const color = SERIES[f.camera % SERIES.length];
  const chosen = f.number === state.selected || samePose(f, frames[state.selected]);
  const flat = Math.hypot(f.ahead[0], f.ahead[1]);
  const heading = Math.atan2(f.ahead[1], f.ahead[0]);
  const reach = length * Math.max(flat, 0.25) * (chosen ? 1.5 : 1);
  const half = Math.atan(f.half ?? 0.5);
  c.beginPath();
  c.moveTo(u, v);
  for (const turn of [-half, half]) {
    const far = reach / Math.cos(half);
    c.lineTo(u + far * Math.cos(heading + turn), v - far * Math.sin(heading + turn));
  }
  c.closePath();
  c.globalAlpha = chosen ? 0.5 : 0.22;
  c.fillStyle = color;
  c.fill();
  c.globalAlpha = 1;
  c.lineWidth = chosen ? 2 : 1;
  c.strokeStyle = color;
  c.stroke();
  c.beginPath();
  c.arc(u, v, chosen ? 6 : 3.5, 0, 2 * Math.PI);
  c.fillStyle = color;
  c.fill();
  c.lineWidth = 1.5;
  c.strokeStyle = "#fff";
  c.stroke();
  const text = String(f.sample);
  const spot = [u + 7, v - 6, 7 * text.length + 4, 13];
  const clear = labels.every(([a, b, w, h]) => spot[0] > a + w || spot[0] + spot[2] < a || spot[1] > b + h || spot[1] + spot[3] < b);
  if (!clear && !chosen) return;
  labels.push(spot);
  c.font = `${chosen ? "600 13px" : "11px"} ${style.fontFamily}`;
  c.lineWidth = 3;
  c.strokeStyle = "#fffd";
  c.strokeText(text, spot[0], spot[1]);
  c.fillStyle = "#111";
  c.fillText(text, spot[0], spot[1]);
}

const samePose = (a, b) => b && a.batch === b.batch && a.camera === b.camera && a.sample === b.sample;

function scaleBar(c, scale, height, style) {
  const rough = 110 / scale;
  const power = 10 ** Math.floor(Math.log10(rough));
  const meters = [5, 2, 1].map((k) => k * power).find((m) => m <= rough) ?? power;
  const ink = style.getPropertyValue("--ink");
  c.strokeStyle = ink;
  c.fillStyle = ink;
  c.lineWidth = 2;
  c.beginPath();
  c.moveTo(16, height - 14);
  c.lineTo(16 + meters * scale, height - 14);
  c.stroke();
  c.font = `11px ${style.fontFamily}`;
  c.fillText(meters >= 1000 ? `${meters / 1000} km` : `${brief(meters)} m`, 16, height - 20);
  c.fillText(upward(mapView.site?.place), 16, 20);
}

function mapSide() {
  const frame = frames[state.selected];
  const children = [];
  children.push(make("p.hint", { id: "map-at" }, " "));
  if (frame && frame.batch === mapView.batch && !frame.fault) {
    const canvas = make("canvas", { role: "img", "aria-label": frame.name });
    const pass = frame.passes.find((name) => state.shown.has(name)) ?? frame.passes[0];
    if (pass) paint(canvas, frame.number, pass, 600, () => canvas.isConnected);
    children.push(make("button.preview", { onclick: () => openFrame(frame.number), "aria-label": `Open ${frame.name}` }, canvas),
      make("b", {}, frame.name), make("dl", {},
        ...[["eye", frame.eye.map((v) => brief(v, 5)).join(", ")],
          ["heading", `${brief(((Math.atan2(frame.ahead[0], frame.ahead[1]) * 180) / Math.PI + 360) % 360)}°`],
          ["pitch", `${brief((Math.asin(Math.max(-1, Math.min(1, frame.ahead[2]))) * 180) / Math.PI)}°`],
          ["sun", frame.sun ? `${brief(frame.sun[0])}° high, bearing ${brief(frame.sun[1])}°` : "–"]]
          .map(([name, value]) => make("div", {}, make("dt", {}, name), make("dd", {}, value)))));
  } else children.push(make("p.hint", {}, "Hover a pose to select its frame."));
  $("map-side").replaceChildren(...children);
}

function startMap() {
  const canvas = $("map-canvas");
  let drag = null;
  canvas.addEventListener("pointermove", (event) => {
    const box = canvas.getBoundingClientRect();
    const [u, v] = [event.clientX - box.left, event.clientY - box.top];
    if (drag) {
      drag.moved += Math.abs(event.movementX) + Math.abs(event.movementY);
      mapView.x += event.movementX;
      mapView.y += event.movementY;
      return drawMap();
    }
    const { to, from } = mapScale();
    let best = 18;
    mapView.near = null;
    for (const f of mapView.poses) {
      const [a, b] = to(f.eye[0], f.eye[1]);
      const far = Math.hypot(a - u, b - v);
      if (far < best) { best = far; mapView.near = f.number; }
    }
    canvas.style.cursor = mapView.near == null ? "grab" : "pointer";
    if (mapView.near != null && mapView.near !== state.selected) select(mapView.near, { scroll: false });
    const spot = $("map-at");
    if (spot) mapText(spot, from(u, v));
  });
  canvas.addEventListener("pointerdown", (event) => { drag = { moved: 0 }; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointerup", () => {
    if (drag && drag.moved < 4 && mapView.near != null) openFrame(mapView.near);
    drag = null;
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = canvas.getBoundingClientRect();
    const [px, py] = [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2];
    const before = mapView.zoom;
    mapView.zoom = Math.min(500, Math.max(1, before * Math.exp(-event.deltaY * 0.002)));
    const turn = mapView.zoom / before;
    mapView.x = mapView.zoom === 1 ? 0 : px - turn * (px - mapView.x);
    mapView.y = mapView.zoom === 1 ? 0 : py - turn * (py - mapView.y);
    drawMap();
  }, { passive: false });
  new ResizeObserver(() => state.tab === "map" && drawMap()).observe(canvas.parentElement);
  on("select", () => { if (state.tab === "map") { mapSide(); drawMap(); } });
  on("tab", () => state.tab === "map" && showMap(frames[state.selected]?.batch ?? 0));
  on("list", () => state.tab === "map" && showMap());
}

function mapText(spot, [x, y]) {
  const g = mapView.ground;
  let text = `x ${x.toFixed(2)}, y ${y.toFixed(2)} m`;
  if (g) {
    const i = Math.round((x - g.corner[0]) / g.step[0]);
    const j = Math.round((y - g.corner[1]) / g.step[1]);
    const z = i >= 0 && j >= 0 && i < g.size[0] && j < g.size[1] ? g.heights[j * g.size[0] + i] : NaN;
    if (Number.isFinite(z)) text += `, ground ${z.toFixed(2)} m`;
  }
  const more = mapView.site ? siteText(mapView.site, x, y) : "";
  if (more) text += `, ${more}`;
  spot.textContent = text;
}
