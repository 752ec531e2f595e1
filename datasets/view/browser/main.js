// Puts the parts together.

function toggleLayer(pass, alone = false) {
  if (alone) state.shown = new Set([pass]);
  else if (!state.shown.delete(pass)) state.shown.add(pass);
  // Nothing at all is never shown.
  if (!state.shown.size) state.shown.add(pass);
  tell("layers");
}

function layerChips() {
  $("layers").replaceChildren(...allPasses.map((pass, i) => make("button.chip", {
    "aria-pressed": String(state.shown.has(pass)), "data-layer": pass,
    title: `${i + 1} toggles; double click: this one alone`,
    onclick: () => toggleLayer(pass), ondblclick: () => toggleLayer(pass, true) },
  pass.startsWith("label.") ? make("small", {}, "level ") : null, passTitle(pass))));
}

function choice(name, label, options) {
  return make("select", { "aria-label": label, "data-filter": name,
    onchange: (event) => { state.filter[name] = event.target.value; refilter(); } },
  ...options.map(([value, text]) => make("option", { value, selected: String(state.filter[name]) === String(value) }, text)));
}

function filterBar() {
  const named = (all, names) => [["", all], ...names.map((name, i) => [i, name])];
  const faulty = frames.some((f) => f.fault);
  const only = [["", "any content"], ...(state.highlight ? [["class", "shows highlighted"]] : []),
    ...(faulty ? [["faults", "faulty only"]] : [])];
  const sort = make("select", { "aria-label": "Sort by",
    onchange: (event) => { state.sort = event.target.value; refilter(); } },
  ...Object.entries(sortKeys).filter(([key]) => key !== "elevation" || frames.some((f) => f.sun))
    .map(([key, [text]]) => make("option", { value: key, selected: key === state.sort }, `by ${text}`)));
  $("filters").replaceChildren(
    index.backends.length > 1 ? choice("backend", "Backend", named("all backends", index.backends)) : "",
    index.batches.length > 1 ? choice("batch", "Batch", named("all batches", index.batches)) : "",
    ...index.settings.map(([name, values]) => choice(`set ${name}`, name,
      [["", `any ${name}`], ...[...new Set(values)].map((value) => [value, `${name} ${value}`])])),
    index.cameras.length > 1 ? choice("camera", "Camera", named("all cameras", index.cameras)) : "",
    only.length > 1 ? choice("only", "Content", only) : "", sort,
    make("button.quiet", { "aria-label": "Descending", "aria-pressed": String(state.descending), title: "Turn the order",
      onclick: (event) => { state.descending = !state.descending; event.currentTarget.setAttribute("aria-pressed", state.descending); event.currentTarget.textContent = state.descending ? "↓" : "↑"; refilter(); } },
    state.descending ? "↓" : "↑"),
    make("input", { type: "range", id: "tile-size", min: 90, max: 640, value: state.tile, "aria-label": "Size of tiles", title: "Size of tiles (+ −)",
      oninput: (event) => { state.tile = +event.target.value; tell("layers"); } }));
}

function resizeTiles(factor) {
  state.tile = Math.round(Math.min(640, Math.max(90, state.tile * factor)));
  $("tile-size").value = state.tile;
  tell("layers");
}

/** Legends of what is shown: classes with their part of the pixels, depth's scale. */
function legendPanels(frame = null) {
  const part = (level, id) => {
    const list = frame ? [frame] : state.list.map((n) => frames[n]);
    let [seen, all] = [0, 0];
    for (const f of list) {
      if (!f.pixels?.[level]) continue;
      seen += f.pixels[level][id] ?? 0;
      all += f.size[0] * f.size[1];
    }
    return all ? seen / all : 0;
  };
  const panels = levels.map((level) => make("section.classes", {}, make("h3", {}, `Level ${level.name}`),
    ...level.classes.map((entry) => ({ ...entry, share: part(level.name, entry.id) }))
      .filter(({ id, share }) => id || share)
      .map(({ id, name, color, share }) => make("button.class", {
        "aria-pressed": String(state.highlight?.level === level.name && state.highlight?.id === id),
        "data-level": level.name, "data-id": id, title: `Highlight ${name}`,
        onclick: () => setHighlight(level.name, id) },
      swatch(color), make("span", {}, name), make("small", {}, id), make("em", {}, share ? percent(Number(share.toPrecision(2))) : "–")))));
  if (allPasses.some((name) => name === "depth" || name === "range" || name === "depth_measured")) {
    const stops = Array.from({ length: 9 }, (_, i) => css(viridis(1 - i / 8)));
    const bar = make("div.scale");
    bar.style.background = `linear-gradient(90deg, ${stops.join(",")})`;
    const [near, far] = depthRange;
    panels.push(make("section", {}, make("h3", {}, "Depth, meters"), bar, make("div.ticks", {},
      ...[0, 0.5, 1].map((t) => make("span", {}, brief(near * (far / near) ** t, 2))))));
  }
  return [...panels, ...motionPanels()];
}

function counts() {
  const [n, all] = [state.list.length, frames.length];
  const s = index.stored;
  const size = s.reduced ? ` · stored at ${s.side} px` : "";
  $("counts").textContent = `${n === all ? count(all) : `${count(n)} of ${count(all)}`} frames${size}`;
  const faulty = frames.filter((f) => f.fault).length;
  const parts = [faulty ? `${count(faulty)} faulty` : "", index.missing_count ? `${count(index.missing_count)} missing` : ""].filter(Boolean);
  $("faults").hidden = !parts.length;
  $("faults").textContent = parts.join(", ");
}

function showTab(name) {
  state.tab = name;
  for (const tab of ["frames", "map", "space", "stats"]) {
    $(tab).hidden = tab !== name;
    $(`tab-${tab}`).setAttribute("aria-selected", String(tab === name));
    $(`tab-${tab}`).tabIndex = tab === name ? 0 : -1;
  }
  $("layers").hidden = name === "stats" || name === "space";
  if (name === "stats") showStats();
  tell("tab", name);
  remember();
}

/** What the address asks for: #frame=12&open&layer=depth&tab=map. */
function restore() {
  const asked = new Map(location.hash.slice(1).split("&").map((part) => part.split("=")));
  const number = Number(asked.get("frame"));
  if (frames[number]) state.selected = number;
  const tab = asked.get("tab");
  showTab(["map", "space", "stats"].includes(tab) && !$(`tab-${tab}`).hidden ? tab : "frames");
  if (frames.length && state.tab === "frames") select(state.selected);
  if (asked.has("open") && frames[number]) {
    state.layer = asked.get("layer");
    openFrame(number);
  }
}

function legend() { $("legend").replaceChildren(...legendPanels()); }

on("layers", layerChips);
on("list", () => { counts(); legend(); if (state.tab === "stats") showStats(); });
on("highlight", () => { legend(); filterBar(); });
for (const tab of ["frames", "map", "space", "stats"]) $(`tab-${tab}`).addEventListener("click", () => showTab(tab));
$("help-button").addEventListener("click", showHelp);
layerChips();
filterBar();
legend();
counts();
startGrid();
startFrame();
startMap();
startSpace();
startKeys();
startWatch();
restore();
document.body.dataset.ready = "1";
