// One frame, large, with all its passes, and what is under the pointer.

const large = $("large");
const view = { zoom: 1, x: 0, y: 0, layers: null, head: null };
let pointed = null;

function openFrame(number) {
  if (frames[number].fault) return select(number);
  state.open = true;
  state.selected = number;
  const frame = frames[number];
  if (!frame.passes.includes(state.layer)) {
    state.layer = frame.passes.find((pass) => state.shown.has(pass)) ?? frame.passes[0];
  }
  $("viewer").hidden = false;
  document.body.classList.add("viewing");
  showFrame();
  $("viewer").querySelector("#close").focus({ preventScroll: true });
}

function closeFrame() {
  state.open = false;
  $("viewer").hidden = true;
  document.body.classList.remove("viewing");
  if (state.tab === "frames") {
    select(state.selected);
    $("grid").focus({ preventScroll: true });
  } else remember();
}

function showFrame() {
  const number = state.selected;
  const frame = frames[number];
  Object.assign(view, { zoom: 1, x: 0, y: 0, layers: null, head: headOf(number) });
  pointed = null;
  viewerBar(frame);
  strip(frame);
  facts(frame, null);
  drawLarge();
  const names = [...frame.passes, "table"];
  Promise.all(names.map((name) => layerOf(number, name))).then((layers) => {
    if (state.selected !== number || !state.open) return;
    view.layers = Object.fromEntries(names.map((name, i) => [name, layers[i]]));
    facts(frame, view.layers.table);
    readOut();
  });
  remember();
}

function viewerBar(frame) {
  const at = state.list.indexOf(frame.number);
  const passes = make("div.chips", { role: "group", "aria-label": "Pass shown" });
  frame.passes.forEach((pass, i) => passes.append(make("button.chip", {
    "aria-pressed": String(pass === state.layer), "data-pass": pass, title: `${passTitle(pass)} (${i + 1})`,
    onclick: () => showLayer(pass) }, passTitle(pass))));
  const over = frame.passes.includes("rgb") && frame.passes.length > 1
    ? make("label.over", { title: "Lay the picture over it" }, "RGB over",
      make("input", { type: "range", min: 0, max: 100, value: 100 * state.over, "aria-label": "RGB over the layer, percent",
        oninput: (event) => { state.over = event.target.value / 100; drawLarge(); } })) : null;
  $("viewer-bar").replaceChildren(
    make("button.quiet", { id: "back", "aria-label": "Previous frame", title: "Previous (←)", onclick: () => stepOpen(-1) }, "←"),
    make("button.quiet", { id: "on", "aria-label": "Next frame", title: "Next (→)", onclick: () => stepOpen(1) }, "→"),
    make("div.where", {}, make("b", {}, frame.name),
      make("span", {}, `${index.backends[frame.backend]} · ${at + 1} of ${count(state.list.length)}`)),
    passes, over ?? "",
    make("button.quiet", { id: "close", "aria-label": "Close", title: "Close (Esc)", onclick: closeFrame }, "✕"));
}

function stepOpen(by) {
  let at = state.list.indexOf(state.selected) + by;
  while (state.list[at] !== undefined && frames[state.list[at]].fault) at += by;
  if (state.list[at] === undefined) return;
  state.selected = state.list[at];
  if (!frames[state.selected].passes.includes(state.layer)) state.layer = frames[state.selected].passes[0];
  showFrame();
}

function showLayer(pass) {
  state.layer = pass;
  for (const chip of $("viewer").querySelectorAll("[data-pass]")) {
    if (chip.hasAttribute("aria-pressed")) chip.setAttribute("aria-pressed", String(chip.dataset.pass === pass));
    if (chip.hasAttribute("aria-selected")) chip.setAttribute("aria-selected", String(chip.dataset.pass === pass));
  }
  drawLarge();
  remember();
}

async function drawLarge() {
  const number = state.selected;
  const pass = state.layer;
  const now = () => state.open && state.selected === number && state.layer === pass;
  large.setAttribute("aria-label", `${passTitle(pass)} of ${frames[number].name}`);
  large.dataset.done = "";
  await paint(large, number, pass, Infinity, now);
  const picture = state.over > 0 && pass !== "rgb" ? await layerOf(number, "rgb") : null;
  if (!now()) return;
  if (picture) {
    const context = large.getContext("2d");
    context.globalAlpha = state.over;
    context.drawImage(picture.image, 0, 0, large.width, large.height);
    context.globalAlpha = 1;
  }
  large.dataset.done = `${number}/${pass}`;
  fitLarge();
}

/** Lays the canvas into the stage: whole at first, then as zoomed and moved. */
function fitLarge() {
  const [w, h] = view.head.stored;
  const box = $("stage").getBoundingClientRect();
  const fit = Math.min((box.width - 16) / w, (box.height - 16) / h);
  const scale = fit * view.zoom;
  const x = (box.width - w * scale) / 2 + view.x;
  const y = (box.height - h * scale) / 2 + view.y;
  large.style.width = `${w}px`;
  large.style.height = `${h}px`;
  large.style.transform = `translate(${x}px,${y}px) scale(${scale})`;
  const photograph = state.layer === "rgb" || state.layer === "clean";
  large.style.imageRendering = photograph && scale < 3 ? "auto" : "pixelated";
  view.scale = scale;
  view.origin = [x, y];
  markPixel();
}

function strip(frame) {
  const width = Math.ceil(150 * (window.devicePixelRatio || 1));
  $("strip").replaceChildren(...frame.passes.map((pass) => {
    const canvas = make("canvas", { "data-strip": pass });
    paint(canvas, frame.number, pass, width, () => canvas.isConnected);
    return make("button.pass", { role: "tab", "data-pass": pass, "aria-selected": String(pass === state.layer),
      onclick: () => showLayer(pass) }, make("span.frame", {}, canvas, make("i.dot", { hidden: true })), make("span", {}, passTitle(pass)));
  }));
}

/** The stored pixel under a point of the window, and the frame's pixel that it is. */
function pixelAt(event) {
  const [w, h] = view.head.stored;
  const [W, H] = view.head.size;
  const box = $("stage").getBoundingClientRect();
  const x = Math.floor((event.clientX - box.left - view.origin[0]) / view.scale);
  const y = Math.floor((event.clientY - box.top - view.origin[1]) / view.scale);
  if (x < 0 || y < 0 || x >= w || y >= h) return null;
  return { x, y, place: y * w + x, column: taken(x, w, W), row: taken(y, h, H) };
}

function markPixel() {
  const cross = $("cross");
  cross.hidden = !pointed;
  for (const dot of $("strip").querySelectorAll(".dot")) {
    dot.hidden = !pointed;
    if (pointed) {
      const [w, h] = view.head.stored;
      dot.style.left = `${(100 * (pointed.x + 0.5)) / w}%`;
      dot.style.top = `${(100 * (pointed.y + 0.5)) / h}%`;
    }
  }
  if (!pointed) return;
  const size = Math.max(view.scale, 5);
  const off = (view.scale - size) / 2;
  cross.style.cssText = `width:${size}px;height:${size}px;transform:translate(${view.origin[0] + pointed.x * view.scale + off}px,${view.origin[1] + pointed.y * view.scale + off}px)`;
}

/** Where in the world a pixel's center hits, by its depth along the optical axis. */
function world(head, column, row, depth) {
  const [fx, s, cx, , fy, cy] = head.K;
  const y = (row + 0.5 - cy) / fy;
  const x = (column + 0.5 - cx - s * y) / fx;
  const p = head.pose;
  return [0, 4, 8].map((r) => depth * (p[r] * x + p[r + 1] * y + p[r + 2]) + p[r + 3]);
}

/** What is known of the pixel under the pointer: [name, text, color or null] a line. */
function known(at) {
  const lines = [["pixel", `${at.column}, ${at.row}`, null]];
  const { layers, head } = view;
  for (const level of levels) {
    const layer = layers[`label.${level.name}`];
    if (!layer) continue;
    const id = layer.ids[layer.places[at.place]];
    const found = level.byId.get(id);
    lines.push([level.name, `${found?.name ?? "unknown"} (${id})`, found?.color ?? [0, 0, 0]]);
  }
  if (layers.instance) {
    const id = layers.instance.ids[layers.instance.places[at.place]];
    lines.push(["instance", id ? `${id}` : "none", id ? instanceColor(id) : null]);
    const table = layers.table;
    const row = table?.row.get(id);
    if (row !== undefined) {
      lines.push(["of", `${shortClass(table.classes[table.class[row]])} ${table.local[row]}`, null]);
      lines.push(["seen", `${count(table.pixels[row])} pixels${table.truncated?.[row] ? ", cut by the border" : ""}`, null]);
      const whole = table.amodal?.[row];
      if (whole != null && whole >= table.pixels[row] && whole > 0) {
        lines.push(["hidden", percent(1 - table.pixels[row] / whole), null]);
      }
    }
  }
  for (const name of ["depth", "range", "depth_measured"]) {
    const layer = layers[name];
    if (!layer) continue;
    const meters = layer.at(at.place);
    const off = layer.error * (layer.even ? 1 : meters);
    lines.push([name === "depth_measured" ? "measured" : name, Number.isFinite(meters) ? `${meters.toPrecision(6)} m ± ${brief(off, 2)}` : Number.isNaN(meters) ? "not a number" : name === "depth_measured" ? "no answer" : "∞ (nothing hit)", null]);
    if (name === "depth" && Number.isFinite(meters) && !head.lens && !head.rolls) {
      lines.push(["world", world(head, at.column, at.row, meters).map((v) => v.toFixed(3)).join(", "), null]);
    }
  }
  if (layers.normal) {
    const n = layers.normal.at(at.place);
    lines.push(["normal", n ? n.map((v) => v.toFixed(2)).join(", ") : "none", null]);
  }
  return [...lines, ...motionLines(layers, at.place)];
}

const shortClass = (path) => path.split("/").filter(Boolean).at(-1) ?? path;

function readOut() {
  const box = $("readout");
  if (!box || !view.layers) return;
  if (!pointed) {
    box.replaceChildren(make("p.hint", {}, "Point at a pixel to read it."));
    return;
  }
  box.replaceChildren(...known(pointed).map(([name, text, color]) =>
    make("div", { "data-name": name }, make("dt", {}, name),
      make("dd", {}, color ? swatch(color) : null, make("span.value", {}, text)))));
}

function swatch(color) {
  const box = make("i.swatch");
  box.style.background = css(color);
  return box;
}

function facts(frame, table) {
  const head = view.head;
  const [W, H] = head.size;
  const [w, h] = head.stored;
  const told = head.facts;
  const list = [
    ["frame", `${W} × ${H}${w === W ? "" : `, stored ${w} × ${h}`}`],
    ["renderer", told.backend_version], ["samples", told.spp ? `${told.spp} a pixel` : null],
    ["exposure", told.exposure_ev != null ? `${brief(told.exposure_ev)} EV` : null],
    ["time", told.time_s != null ? `${brief(told.time_s, 6)} s` : null],
    ["denoised", told.denoised ? String(told.denoised) : null],
    ["sun", frame.sun ? `${brief(frame.sun[0])}° high, bearing ${brief(frame.sun[1])}°` : null],
    ["error of rgb", frame.error != null ? `${percent(frame.error)} (relative rms)` : null],
  ].filter(([, value]) => value != null);
  const panels = [
    make("section", {}, make("h3", {}, "Under the pointer"), make("dl", { id: "readout", "aria-live": "off" })),
    make("section", {}, make("h3", {}, "Frame"), make("dl", {}, ...list.map(([name, value]) =>
      make("div", {}, make("dt", {}, name), make("dd", {}, value))))),
  ];
  if (frame.total > 0) panels.push(make("section", {}, make("h3", {}, `Seconds, ${brief(frame.total)} in all`), stepBars(frame)));
  panels.push(...legendPanels(frame));
  if (table) panels.push(instancePanel(table, frame));
  $("facts").replaceChildren(...panels);
  readOut();
}

function stepBars(frame) {
  const pairs = index.steps.map((name, i) => [name, frame.seconds[i], i]).filter(([, s]) => s != null);
  const most = Math.max(...pairs.map(([, s]) => s), 1e-9);
  return make("div.bars", {}, ...pairs.sort((a, b) => b[1] - a[1]).map(([name, s, i]) => {
    const bar = make("i");
    bar.style.cssText = `width:${(100 * s) / most}%;background:${SERIES[i % SERIES.length]}`;
    return make("div", {}, make("span", {}, name), make("div.track", {}, bar), make("em", {}, brief(s)));
  }));
}

function instancePanel(table, frame) {
  const order = table.id.map((_, i) => i).sort((a, b) => table.pixels[b] - table.pixels[a]).slice(0, 12);
  const head = ["id", "class", "pixels", ...(table.amodal ? ["hidden"] : []), ...(table.depth_min ? ["nearest"] : [])];
  const cells = (i) => [
    make("td", {}, swatch(instanceColor(table.id[i])), String(table.id[i])),
    make("td", {}, shortClass(table.classes[table.class[i]])), make("td", {}, count(table.pixels[i])),
    ...(table.amodal ? [make("td", {}, table.amodal[i] ? percent(1 - table.pixels[i] / table.amodal[i]) : "–")] : []),
    ...(table.depth_min ? [make("td", {}, `${brief(table.depth_min[i])} m`)] : [])];
  const shown = table.id.length === frame.instances ? "" : `, ${count(table.id.length)} at the stored resolution`;
  return make("section", {}, make("h3", {}, `Instances: ${count(frame.instances ?? 0)}${shown}`),
    make("table", {}, make("thead", {}, make("tr", {}, ...head.map((name) => make("th", { scope: "col" }, name)))),
      make("tbody", {}, ...order.map((i) => make("tr", {}, ...cells(i))))));
}

function startFrame() {
  const stage = $("stage");
  let drag = null;
  stage.addEventListener("pointermove", (event) => {
    if (!view.head || !view.origin) return;
    if (drag) {
      view.x += event.clientX - drag[0];
      view.y += event.clientY - drag[1];
      drag = [event.clientX, event.clientY];
      return fitLarge();
    }
    pointed = pixelAt(event);
    markPixel();
    readOut();
  });
  stage.addEventListener("pointerleave", () => { pointed = null; markPixel(); readOut(); });
  stage.addEventListener("pointerdown", (event) => {
    if (view.zoom > 1 && event.button === 0) {
      drag = [event.clientX, event.clientY];
      stage.setPointerCapture(event.pointerId);
    }
  });
  stage.addEventListener("pointerup", () => { drag = null; });
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    const before = view.zoom;
    view.zoom = Math.min(64, Math.max(1, view.zoom * Math.exp(-event.deltaY * 0.002)));
    const box = stage.getBoundingClientRect();
    const [px, py] = [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2];
    const turn = view.zoom / before;
    // The point under the pointer stays where it is.
    view.x = view.zoom === 1 ? 0 : px - turn * (px - view.x);
    view.y = view.zoom === 1 ? 0 : py - turn * (py - view.y);
    fitLarge();
  }, { passive: false });
  stage.addEventListener("dblclick", () => { Object.assign(view, { zoom: 1, x: 0, y: 0 }); fitLarge(); });
  new ResizeObserver(() => state.open && view.origin && fitLarge()).observe(stage);
  on("highlight", () => {
    if (!state.open) return;
    drawLarge();
    strip(frames[state.selected]);
    facts(frames[state.selected], view.layers?.table);
  });
}
