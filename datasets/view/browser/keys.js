// The keyboard.

const HELP = [
  ["← → ↑ ↓", "move between frames"], ["Home, End, PgUp, PgDn", "further"], ["Enter", "open the frame"],
  ["Esc", "close"], ["1 … 9", "layers, in their order: toggle; in a frame: show"],
  ["r i d n", "RGB, instances, depth, normals"], ["l", "next label level"],
  ["+ −", "larger, smaller tiles"], ["f m t s", "frames, map, three dimensions, statistics"],
  ["x", "no highlight"], ["?", "this help"],
];

function showHelp() {
  const box = $("help");
  box.replaceChildren(make("h2", {}, "Keys"), make("dl", {}, ...HELP.map(([key, what]) =>
    make("div", {}, make("dt", {}, make("kbd", {}, key)), make("dd", {}, what)))),
  make("p.hint", {}, "Click a class in the legend to highlight it. In a frame: wheel zooms, dragging moves, a double click fits."),
  make("form", { method: "dialog" }, make("button.chip", { autofocus: true }, "Close")));
  box.showModal();
}

/** Shows a pass in the frame that is open, or toggles it in the grid. */
function usePass(pass) {
  if (!pass) return;
  if (state.open) {
    if (frames[state.selected].passes.includes(pass)) showLayer(pass);
  } else toggleLayer(pass);
}

function nextLevel() {
  const passes = allPasses.filter((name) => name.startsWith("label."));
  if (!passes.length) return;
  if (state.open) return usePass(passes[(passes.indexOf(state.layer) + 1) % passes.length]);
  const now = passes.findIndex((name) => state.shown.has(name));
  for (const name of passes) state.shown.delete(name);
  if (now + 1 < passes.length) state.shown.add(passes[now + 1]);
  if (!state.shown.size) state.shown.add(allPasses[0]);
  tell("layers");
}

const letters = {
  r: () => usePass(allPasses.find((name) => name === "rgb")),
  i: () => usePass(allPasses.find((name) => name === "instance")),
  d: () => usePass(allPasses.find((name) => name === "depth")),
  n: () => usePass(allPasses.find((name) => name === "normal")),
  l: nextLevel,
  f: () => showTab("frames"), m: () => showTab("map"), t: () => { if (!$("tab-space").hidden) showTab("space"); }, s: () => showTab("stats"),
  x: () => setHighlight(null), "?": showHelp,
  "+": () => resizeTiles(1.25), "=": () => resizeTiles(1.25), "-": () => resizeTiles(0.8),
};

function startKeys() {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
    const at = event.target;
    const typing = at.matches?.("select, input");
    if (event.key === "Escape") {
      if (state.open) closeFrame();
      else if (typing) at.blur();
      return;
    }
    if (typing && (event.key.startsWith("Arrow") || event.key.length === 1 || event.key === "Enter")) return;
    if (state.open && event.key === "Tab") return keepInside(event);
    if (moved(event) || pressed(event)) event.preventDefault();
  });
}

function moved(event) {
  const page = Math.max(1, Math.floor($("grid").clientHeight / layout.cell[1])) * layout.columns;
  const by = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -layout.columns, ArrowDown: layout.columns,
    PageUp: -page, PageDown: page, Home: -frames.length, End: frames.length }[event.key];
  if (by === undefined) return false;
  if (state.open) {
    stepOpen(event.key === "ArrowUp" ? -1 : event.key === "ArrowDown" ? 1 : Math.sign(by) * Math.min(Math.abs(by), 1));
    return true;
  }
  const tab = event.target.closest?.("[role=tablist]");
  if (tab) {
    const names = ["frames", "map", "stats"];
    const next = names[(names.indexOf(state.tab) + Math.sign(by) + 3) % 3];
    showTab(next);
    $(`tab-${next}`).focus();
    return true;
  }
  if (state.tab === "stats") return false;
  step(state.tab === "map" ? Math.sign(by) : by);
  return true;
}

function pressed(event) {
  const onButton = event.target.matches?.("button, a");
  if (event.key === "Enter" && !state.open && !onButton && state.tab !== "stats") {
    openFrame(state.selected);
    return true;
  }
  if (/^[1-9]$/.test(event.key)) {
    usePass((state.open ? frames[state.selected].passes : allPasses)[+event.key - 1]);
    return true;
  }
  const act = letters[event.key];
  if (!act || (state.open && "fms".includes(event.key))) return false;
  act();
  return true;
}

/** Tab stays in the open frame. */
function keepInside(event) {
  const inside = [...$("viewer").querySelectorAll("button, input, select")].filter((e) => e.offsetParent);
  const at = inside.indexOf(document.activeElement);
  const next = inside[(at + (event.shiftKey ? -1 : 1) + inside.length) % inside.length];
  next?.focus();
  event.preventDefault();
}
