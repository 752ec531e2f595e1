// Statistics over the frames that pass the filters, and seconds and errors frame by frame.

/** Counts of the groups (backend, batch, camera) that pass; of several backends the first. */
function tallied() {
  const { backend, batch, camera } = state.filter;
  const sum = { pixels: {}, instances: new Map(), sizes: new Map(), distances: new Map(), hidden: new Map() };
  const add = (map, pairs) => { for (const [k, n] of pairs) map.set(k, (map.get(k) ?? 0) + n); };
  // Annotation is the same whoever rendered: a view is counted once.
  const seen = new Set();
  for (const [a, b, c, tally] of index.tallies) {
    if ((backend !== "" && a !== +backend) || (batch !== "" && b !== +batch) || (camera !== "" && c !== +camera) || !ofSettings(b)) continue;
    if (seen.has(`${b}/${c}`)) continue;
    seen.add(`${b}/${c}`);
    for (const [level, pairs] of Object.entries(tally.pixels)) add((sum.pixels[level] ??= new Map()), pairs);
    for (const name of ["instances", "sizes", "distances", "hidden"]) add(sum[name], tally[name]);
  }
  return sum;
}

function card(title, note, ...children) {
  return make("figure.card", {}, make("figcaption", {}, make("b", {}, title), note ? make("span", {}, note) : null), ...children);
}

/** Horizontal bars: [name, value, color, text, onclick]. */
function barList(rows) {
  const most = Math.max(...rows.map(([, value]) => value), 1e-12);
  return make("div.bars", {}, ...rows.map(([name, value, color, text, act]) => {
    const bar = make("i");
    bar.style.cssText = `width:${(100 * value) / most}%;background:${color}`;
    return make(act ? "button" : "div", act ? { onclick: act, title: "Highlight it" } : {},
      make("span", {}, name), make("div.track", {}, bar), make("em", {}, text));
  }));
}

/** A histogram: bin k is from edges[k - 1] to edges[k]; what is outside of all edges counts, too. */
function histogram(map, edges, unit, format, span = null) {
  const bins = [...map.keys()];
  if (!bins.length) return make("p.hint", {}, "nothing to count");
  const [first, last] = span ?? [Math.min(...bins), Math.max(...bins)];
  const edge = (k) => (k <= 0 ? "" : format(edges[Math.min(k, edges.length) - 1]));
  const range = (k) => (k === 0 ? `below ${format(edges[0])}` : k >= edges.length ? `${format(edges.at(-1))} and more`
    : `${edge(k)} – ${edge(k + 1)}`);
  const [width, height, base] = [420, 150, 126];
  const n = last - first + 1;
  const step = (width - 8) / n;
  const most = Math.max(...map.values());
  const total = [...map.values()].reduce((a, b) => a + b, 0);
  const plot = draw("svg", { viewBox: `0 0 ${width} ${height}`, class: "plot", role: "img" });
  plot.append(draw("line", { x1: 4, x2: width - 4, y1: base + 0.5, y2: base + 0.5, class: "axis" }));
  for (let bin = first; bin <= last; bin++) {
    const value = map.get(bin) ?? 0;
    const tall = value ? Math.max(1, ((base - 10) * value) / most) : 0;
    const bar = draw("rect", { x: 4 + (bin - first) * step + 0.5, y: base - tall, width: Math.max(0.5, step - 1), height: tall, class: "bin" });
    bar.append(Object.assign(draw("title"), { textContent: `${range(bin)} ${unit}: ${count(value)} (${percent(value / total)})` }));
    plot.append(bar);
  }
  const every = Math.max(1, Math.ceil(n / 7));
  for (let bin = first; bin <= last + 1; bin += every) {
    const x = 4 + (bin - first) * step;
    plot.append(Object.assign(draw("text", { x: Math.min(width - 4, Math.max(4, x)), y: height - 6, class: "tick",
      "text-anchor": bin === first ? "start" : bin > last ? "end" : "middle" }), { textContent: edge(bin) }));
  }
  return plot;
}

/** The suns over the sky: the horizon is the rim, the middle straight up, north at the top. */
function sunPlot(list) {
  const plot = draw("svg", { viewBox: "-112 -112 224 224", class: "plot sky", role: "img" });
  for (const elevation of [0, 30, 60]) {
    plot.append(draw("circle", { r: 100 * (1 - elevation / 90), class: "axis", fill: "none" }));
    plot.append(Object.assign(draw("text", { x: 3, y: -100 * (1 - elevation / 90) + 10, class: "tick" }), { textContent: `${elevation}°` }));
  }
  for (const [text, x, y] of [["N", 0, -103], ["E", 107, 4], ["S", 0, 111], ["W", -107, 4]]) {
    plot.append(Object.assign(draw("text", { x, y, class: "tick", "text-anchor": "middle" }), { textContent: text }));
  }
  const seen = new Set();
  for (const f of list) {
    const key = `${f.batch}/${f.sample}`;
    if (!f.sun || seen.has(key) || seen.size > 3000) continue;
    seen.add(key);
    const [elevation, azimuth] = f.sun;
    const r = 100 * (1 - Math.max(0, elevation) / 90);
    const turn = (azimuth * Math.PI) / 180;
    const dot = draw("circle", { cx: r * Math.sin(turn), cy: -r * Math.cos(turn), r: seen.size > 300 ? 2 : 3.5, class: "sun" });
    dot.append(Object.assign(draw("title"), { textContent: `${index.batches[f.batch]}, sample ${f.sample}: ${brief(elevation)}° high, bearing ${brief(azimuth)}°` }));
    plot.append(dot);
  }
  return plot;
}

/** A value a frame over the list, or stacked ones; hovering tells, a click opens. */
function series(list, valuesOf, names, colors, format) {
  const canvas = make("canvas.series", { role: "img", tabindex: "-1" });
  const told = make("p.told", {}, " ");
  const values = list.map(valuesOf);
  const most = highest(values.map((v) => v.reduce((a, b) => a + (b ?? 0), 0)), 1e-12);
  const paintIt = () => {
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    if (!w) return;
    Object.assign(canvas, { width: w * ratio, height: h * ratio });
    const c = canvas.getContext("2d");
    c.scale(ratio, ratio);
    const style = getComputedStyle(document.body);
    c.font = `11px ${style.fontFamily}`;
    const tall = h - 24;
    const wide = w / list.length;
    // Of more frames than columns each column shows its largest.
    for (let x = 0; x < Math.min(w, list.length); x++) {
      const from = wide >= 1 ? x : Math.floor((x * list.length) / w);
      const to = wide >= 1 ? x + 1 : Math.max(from + 1, Math.floor(((x + 1) * list.length) / w));
      let best = values[from];
      const sum = (v) => v.reduce((a, b) => a + (b ?? 0), 0);
      for (let i = from + 1; i < to; i++) if (sum(values[i]) > sum(best)) best = values[i];
      let y = h - 16;
      best.forEach((v, k) => {
        const high = ((v ?? 0) / most) * tall;
        c.fillStyle = colors[k % colors.length];
        c.fillRect(wide >= 1 ? x * wide : x, y - high, wide >= 3 ? wide - 1 : Math.max(1, wide), high);
        y -= high;
      });
    }
    c.fillStyle = style.getPropertyValue("--faint");
    c.fillText(format(most), 2, 9);
    c.fillText("1", 0, h - 3);
    c.textAlign = "right";
    c.fillText(count(list.length), w, h - 3);
  };
  const under = (event) => {
    const box = canvas.getBoundingClientRect();
    return Math.min(list.length - 1, Math.max(0, Math.floor(((event.clientX - box.left) / box.width) * list.length)));
  };
  canvas.addEventListener("pointermove", (event) => {
    const at = under(event);
    const parts = values[at].map((v, k) => (v == null || names.length < 2 ? null : `${names[k]} ${format(v)}`)).filter(Boolean);
    const sum = values[at].reduce((a, b) => a + (b ?? 0), 0);
    told.textContent = `${list[at].name}: ${format(sum)}${parts.length ? ` (${parts.join(", ")})` : ""}`;
  });
  canvas.addEventListener("click", (event) => openFrame(list[under(event)].number));
  const keys = names.length > 1 ? make("div.keys", {}, ...names.map((name, k) => {
    const dot = make("i.swatch");
    dot.style.background = colors[k % colors.length];
    return make("span", {}, dot, name);
  })) : null;
  new ResizeObserver(paintIt).observe(canvas);
  return make("div", {}, canvas, told, keys);
}

function showStats() {
  const sum = tallied();
  const list = state.list.map((n) => frames[n]).filter((f) => !f.fault);
  const cards = [];
  for (const level of levels) {
    const map = sum.pixels[level.name];
    if (!map) continue;
    const total = [...map.values()].reduce((a, b) => a + b, 0);
    const rows = level.classes.filter(({ id }) => map.has(id)).sort((a, b) => map.get(b.id) - map.get(a.id))
      .map(({ id, name, color }) => [name, map.get(id), css(color), percent(map.get(id) / total), () => setHighlight(level.name, id)]);
    cards.push(card(`Pixels, level ${level.name}`, `${count(total)} pixels`, barList(rows)));
  }
  if (sum.instances.size) {
    const rows = [...sum.instances].sort((a, b) => b[1] - a[1]).slice(0, 24)
      .map(([name, n], i) => [shortClass(name), n, SERIES[i % SERIES.length], count(n)]);
    cards.push(card("Instances by class", "one in each frame that shows it", barList(rows)));
    cards.push(card("Size of instances", "pixels, by powers of two",
      histogram(sum.sizes, index.edges.sizes, "pixels", count)));
  }
  if (sum.distances.size) {
    cards.push(card("Distance", "meters along the optical axis, of pixels that hit something",
      histogram(sum.distances, index.edges.distances, "m", (v) => brief(v, 2))));
  }
  if (sum.hidden.size) {
    cards.push(card("Hidden part of instances", "1 − pixels seen / pixels it would have alone; first bar: nothing hidden",
      histogram(sum.hidden, index.edges.hidden, "hidden", (v) => `${Math.round(100 * v)} %`, [0, 11])));
  }
  if (list.some((f) => f.sun)) cards.push(card("Sun", "by batch and sample; rim: horizon", sunPlot(list)));
  const timed = list.filter((f) => f.total > 0);
  if (timed.length) {
    cards.push(wide(card("Seconds a frame, by step", "in the order of the grid; hover tells, a click opens",
      series(timed, (f) => f.seconds, index.steps, SERIES, (v) => `${brief(v)} s`))));
  }
  const erred = list.filter((f) => f.error != null);
  if (erred.length) {
    cards.push(wide(card("Estimated error of rgb", "relative rms, from two half renders",
      series(erred, (f) => [f.error], ["error"], [SERIES[5]], percent))));
  }
  cards.push(wide(card("How this page stores frames", "", storedText())));
  $("stats").replaceChildren(...cards);
}

function wide(element) {
  element.classList.add("wide");
  return element;
}

function storedText() {
  const s = index.stored;
  const size = s.reduced
    ? `at most ${s.side} pixels along the longer side (${count(s.reduced)} of ${count(frames.length)} frames are reduced)`
    : "at full resolution";
  const lines = [
    `Frames are stored ${size}. Ids, depth and normals are never blended: each stored pixel is one pixel of the frame (nearest).`,
    `Depth is stored in ${s.bits} bits, in equal ratios from a frame's nearest to its farthest hit: off by ${percent(s.depth_error)} at most.`,
    allPasses.includes("normal") ? `Normals are off by ${s.normal_error_deg}° at most.` : null,
    allPasses.some((pass) => MOTION[pass]) ? `Flow, scene flow and disparity are off by ${percent(s.motion_error)} at most; beyond 65,504 they are that.` : null,
    allPasses.includes("rgb") ? `RGB is the frame's picture as a JPEG of quality ${s.quality}: what the sensor took where it has imaging, else radiance under the shared tone curve.` : null,
    "Statistics are counted on all pixels of the frames as rendered, not on the stored ones.",
    index.missing_count ? `${count(index.missing_count)} frames should be there and are missing: ${index.missing.slice(0, 12).join("; ")}${index.missing_count > 12 ? " …" : ""}` : null,
    `Written by scenec ${index.scenec}.`,
  ];
  return make("div.prose", {}, ...lines.filter(Boolean).map((line) => make("p", {}, line)));
}
