// The grid: as many tiles as are in sight, whatever the number of frames.

const GAP = 10;
const CAPTION = 26;
const sheet = $("sheet");
const tiles = new Map();
let layout = { columns: 1, cell: [0, 0], picture: [0, 0], across: 1 };

/** Sizes of tiles from the width that is there, and the height that the tallest frame needs. */
function measure() {
  const room = Math.max(120, $("grid").clientWidth - GAP);
  const passes = Math.max(1, state.shown.size);
  const tile = Math.min(state.tile, room - GAP);
  const across = Math.max(1, Math.min(passes, Math.floor((room - GAP) / tile)));
  const tall = Math.max(0.1, ...new Set(state.list.map((n) => frames[n].size[1] / frames[n].size[0])));
  // As many columns as make tiles of nearly the size asked for; they fill the width.
  const ideal = room / (across * tile + GAP);
  const many = Math.max(1, ideal / Math.floor(ideal) > Math.ceil(ideal) / ideal ? Math.ceil(ideal) : Math.floor(ideal));
  const wide = Math.floor((room / many - GAP) / across);
  const high = Math.round(wide * Math.min(tall, 2));
  layout = {
    columns: many, across, picture: [wide, high],
    cell: [across * wide + GAP, Math.ceil(passes / across) * high + CAPTION + GAP],
  };
  sheet.style.height = `${Math.ceil(state.list.length / many) * layout.cell[1] + GAP}px`;
}

/** Makes tiles that came into sight and removes those that went out of it. */
function place() {
  const grid = $("grid");
  const [, high] = layout.cell;
  const first = Math.max(0, Math.floor(grid.scrollTop / high) - 1) * layout.columns;
  const last = Math.min(state.list.length,
    (Math.ceil((grid.scrollTop + grid.clientHeight) / high) + 1) * layout.columns);
  for (const [at, tile] of tiles) {
    if (at < first || at >= last) {
      tile.remove();
      tiles.delete(at);
    }
  }
  for (let at = first; at < last; at++) if (!tiles.has(at)) tiles.set(at, makeTile(at));
  const selected = state.list.indexOf(state.selected);
  if (tiles.has(selected)) grid.setAttribute("aria-activedescendant", `t${selected}`);
  else grid.removeAttribute("aria-activedescendant");
}

function makeTile(at) {
  const frame = frames[state.list[at]];
  const [width, height] = layout.cell;
  const tile = make("div.tile", {
    id: `t${at}`, role: "option", "aria-setsize": state.list.length, "aria-posinset": at + 1,
    "aria-selected": String(frame.number === state.selected), "data-frame": frame.number,
    "aria-label": `${frame.name}, ${index.backends[frame.backend]}${frame.fault ? `, ${frame.fault[0]}` : ""}`,
    onclick: () => (state.selected === frame.number ? openFrame(frame.number) : select(frame.number)),
    ondblclick: () => openFrame(frame.number),
  });
  tile.style.cssText = `width:${width - GAP}px;height:${height - GAP}px;` +
    `transform:translate(${GAP + (at % layout.columns) * width}px,${GAP + Math.floor(at / layout.columns) * height}px)`;
  if (frame.fault) {
    tile.classList.add("faulty");
    tile.append(make("div.fault", {}, make("b", {}, frame.fault[0]), make("span", {}, frame.fault[1])));
  } else {
    const pictures = make("div.pictures");
    for (const pass of allPasses.filter((name) => state.shown.has(name))) {
      pictures.append(makePicture(tile, frame, pass));
    }
    tile.append(pictures);
  }
  tile.append(caption(frame));
  sheet.append(tile);
  return tile;
}

function makePicture(tile, frame, pass) {
  const [width, height] = layout.picture;
  const box = make("div.picture");
  box.style.cssText = `width:${width}px;height:${height}px`;
  if (!frame.passes.includes(pass)) {
    box.append(make("span.none", {}, `no ${passTitle(pass)}`));
    return box;
  }
  const canvas = make("canvas", { "data-pass": pass });
  box.append(canvas);
  if (state.shown.size > 1) box.append(make("span.tag", {}, passTitle(pass)));
  const limit = Math.ceil(width * (window.devicePixelRatio || 1));
  canvas.paint = () => paint(canvas, frame.number, pass, limit, () => tile.isConnected)
    .then(() => { canvas.dataset.done = "1"; });
  // A tile that is only passed by is never decoded.
  setTimeout(() => tile.isConnected && canvas.paint(), 30);
  return box;
}

function caption(frame) {
  const parts = [];
  if (index.batches.length > 1) parts.push(index.batches[frame.batch].replace(/^batch_0*(?=\d)/, "batch "));
  parts.push(index.cameras[frame.camera], `#${frame.sample}`);
  if (index.backends.length > 1) parts.push(index.backends[frame.backend]);
  const value = { error: () => percent(frame.error), seconds: () => `${brief(frame.total)} s`,
    instances: () => `${count(frame.instances ?? 0)} inst.`,
    elevation: () => (frame.sun ? `sun ${brief(frame.sun[0])}°` : "–"),
    share: () => percent(shareOf(frame, state.highlight)) }[state.sort];
  return make("div.caption", { title: frame.name }, make("span", {}, parts.join(" · ")),
    value && !frame.fault ? make("em", {}, value()) : null);
}

function rebuild() {
  for (const tile of tiles.values()) tile.remove();
  tiles.clear();
  if (state.tab !== "frames") return;
  measure();
  place();
  sheet.querySelector(".empty")?.remove();
  if (!state.list.length) sheet.append(make("p.empty", {}, "No frame passes these filters."));
}

/** Selects a frame, brings it into sight, and shows it if one is open. */
function select(number, { scroll = true } = {}) {
  for (const tile of tiles.values()) tile.setAttribute("aria-selected", "false");
  state.selected = number;
  const at = state.list.indexOf(number);
  if (scroll && state.tab === "frames" && at >= 0) {
    const grid = $("grid");
    const top = Math.floor(at / layout.columns) * layout.cell[1];
    if (top < grid.scrollTop) grid.scrollTop = top;
    const bottom = top + layout.cell[1] + GAP;
    if (bottom > grid.scrollTop + grid.clientHeight) grid.scrollTop = bottom - grid.clientHeight;
    place();
  }
  tiles.get(at)?.setAttribute("aria-selected", "true");
  tell("select", number);
  remember();
}

/** Moves the selection by so many frames of the list. */
function step(by) {
  const at = Math.min(state.list.length - 1, Math.max(0, state.list.indexOf(state.selected) + by));
  if (state.list.length) select(state.list[at]);
}

function startGrid() {
  $("grid").setAttribute("tabindex", "0");
  $("grid").addEventListener("scroll", () => requestAnimationFrame(place), { passive: true });
  new ResizeObserver(() => {
    const top = Math.floor($("grid").scrollTop / (layout.cell[1] || 1)) * layout.columns;
    rebuild();
    if (state.tab === "frames") $("grid").scrollTop = Math.floor(top / layout.columns) * layout.cell[1];
  }).observe($("grid"));
  on("list", () => { $("grid").scrollTop = 0; rebuild(); });
  on("layers", rebuild);
  on("tab", rebuild);
  on("highlight", () => {
    for (const canvas of sheet.querySelectorAll("canvas")) canvas.paint();
  });
}
