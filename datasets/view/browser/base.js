// What all parts share: the index, the state, small helpers.

const $ = (id) => document.getElementById(id);
const index = JSON.parse($("index").content.textContent);

/** An element: make("b.name", {title: "x"}, child, ...). */
function make(what, attributes = {}, ...children) {
  const [tag, ...classes] = what.split(".");
  const element = document.createElement(tag);
  if (classes.length) element.className = classes.join(" ");
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value != null) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child != null));
  return element;
}

/** The same for SVG. */
function draw(tag, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Of numbers that may be as many as frames: more than a function takes as its arguments. */
const highest = (values, least = -Infinity) => values.reduce((a, b) => Math.max(a, b), least);
const lowest = (values, most = Infinity) => values.reduce((a, b) => Math.min(a, b), most);

const columns = Object.fromEntries(index.columns.map((name, at) => [name, at]));

/** All frames, with names in place of positions. */
const frames = index.frames.map((row, number) => {
  const [backend, batch, camera, sample] = row[columns.at];
  const fault = row[columns.fault];
  return {
    number, backend, batch, camera, sample, fault,
    name: `${index.batches[batch]} / ${index.cameras[camera]} / ${sample}`,
    seconds: row[columns.seconds],
    total: row[columns.seconds].reduce((sum, s) => sum + (s ?? 0), 0),
    error: row[columns.error], eye: row[columns.eye], ahead: row[columns.ahead],
    half: row[columns.half], size: row[columns.size] ?? [4, 3],
    passes: index.passes[row[columns.passes]] ?? [],
    pixels: row[columns.pixels], instances: row[columns.instances],
    sun: row[columns.sun] ?? index.suns[batch]?.[sample] ?? null,
  };
});

const levels = index.levels.map((level) => ({
  name: level.name,
  classes: level.classes.map(([id, name, color]) => ({ id, name, color })),
  byId: new Map(level.classes.map(([id, name, color]) => [id, { id, name, color }])),
}));
const levelOf = (pass) => levels.find((level) => `label.${level.name}` === pass);

/** Passes of any frame, in the order they are shown. */
const allPasses = [...new Set(frames.flatMap((frame) => frame.passes))];

function passTitle(pass) {
  if (pass.startsWith("label.")) return pass.slice(6);
  return { rgb: "RGB", clean: "RGB, clean", raw: "Raw", instance: "Instances", depth: "Depth", range: "Range",
    depth_measured: "Depth, measured", normal: "Normals", flow: "Flow", flow_backward: "Flow, backward",
    scene_flow: "Scene flow", disparity: "Disparity", occlusion: "Occlusion", occlusion_backward: "Occlusion, backward",
    disparity_occlusion: "Occlusion by disparity" }[pass] ?? pass;
}

/** What is chosen; listeners hear of each change. */
const state = {
  shown: new Set([allPasses[0]].filter(Boolean)),
  filter: { backend: "", batch: "", camera: "", only: "" },
  sort: "order", descending: false, tile: 220,
  selected: 0, open: false, layer: null, over: 0, tab: "frames",
  highlight: null,
  list: frames.map((frame) => frame.number),
};
const listeners = {};
function on(event, listener) { (listeners[event] ??= []).push(listener); }
function tell(event, value) { for (const listener of listeners[event] ?? []) listener(value); }

const grouped = new Intl.NumberFormat("en-US");
const count = (value) => grouped.format(value);
/** A number with three digits. */
function brief(value, digits = 3) {
  if (value == null || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return "∞";
  if (value !== 0 && (Math.abs(value) >= 1e6 || Math.abs(value) < 1e-4)) return value.toExponential(digits - 1);
  return String(Number(value.toPrecision(digits)));
}
const percent = (value) => (value == null ? "–" : `${brief(100 * value)} %`);
const css = (color) => `rgb(${color[0]} ${color[1]} ${color[2]})`;

const sortKeys = {
  order: ["batch, camera, sample", (f) => f.number],
  sample: ["sample", (f) => f.sample],
  error: ["estimated error", (f) => f.error],
  seconds: ["seconds", (f) => f.total],
  instances: ["instances seen", (f) => f.instances],
  elevation: ["sun's elevation", (f) => f.sun?.[0]],
  share: ["share of the highlighted class", (f) => shareOf(f, state.highlight)],
};

/** Part of a frame's pixels that a class has. */
function shareOf(frame, highlight) {
  if (!highlight || !frame.pixels) return null;
  const [w, h] = frame.size;
  return (frame.pixels[highlight.level]?.[highlight.id] ?? 0) / (w * h);
}

/** Whether a batch is of a point with the chosen settings, in a sweep. */
const ofSettings = (batch) => index.settings.every(([name, values]) =>
  [undefined, "", values[batch]].includes(state.filter[`set ${name}`]));

/** Which frames pass the filters, sorted. */
function refilter() {
  const { backend, batch, camera, only } = state.filter;
  const wanted = (f) =>
    (backend === "" || f.backend === +backend) && (batch === "" || f.batch === +batch) &&
    (camera === "" || f.camera === +camera) && ofSettings(f.batch) &&
    (only === "" || (only === "faults" ? Boolean(f.fault) : shareOf(f, state.highlight) > 0));
  const key = sortKeys[state.sort][1];
  const found = frames.filter(wanted).map((f) => [key(f), f.number]);
  const turn = state.descending ? -1 : 1;
  // Frames without a value stand last, whichever way the others are sorted.
  found.sort(([a, i], [b, j]) =>
    (a == null) - (b == null) || (a == null ? 0 : turn * (a - b)) || i - j);
  state.list = found.map(([, number]) => number);
  if (!state.list.includes(state.selected) && state.list.length) state.selected = state.list[0];
  tell("list");
}

function setHighlight(level, id) {
  const same = state.highlight?.level === level && state.highlight?.id === id;
  state.highlight = same || level == null ? null : { level, id };
  if (state.sort === "share" || state.filter.only === "class") refilter();
  tell("highlight");
}

/** The same list or sort with the next frames kept in the address: reloading comes back here. */
function remember() {
  const parts = [`frame=${state.selected}`];
  if (state.open) parts.push("open", `layer=${state.layer}`);
  if (state.tab !== "frames") parts.push(`tab=${state.tab}`);
  history.replaceState(null, "", `#${parts.join("&")}`);
}
