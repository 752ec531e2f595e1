// Colors, the same as scenec.datasets.colors, and layers onto canvases.

const VIRIDIS = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141],
  [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]];

function viridis(t) {
  const at = Math.min(1, Math.max(0, t)) * (VIRIDIS.length - 1);
  const low = Math.min(Math.floor(at), VIRIDIS.length - 2);
  return VIRIDIS[low].map((v, k) => Math.round(v + (at - low) * (VIRIDIS[low + 1][k] - v)));
}

function instanceColor(id) {
  if (id === 0) return [240, 240, 240];
  const hue = (id * 0.6180339887498949) % 1;
  const saturation = 0.45 + 0.5 * ((id * 0.7548776662466927) % 1);
  const value = 0.95 - 0.45 * ((id * 0.5698402909980532) % 1);
  return [5, 3, 1].map((turn) => {
    const k = Math.abs(((hue * 6 + turn) % 6) - 3) - 1;
    return Math.round(255 * value * (1 - saturation * (1 - Math.min(1, Math.max(0, k)))));
  });
}

/** Lengths between which parts of all pixels lie, rounded outward to edges of bins; null of none. */
function lengthRange(pairsOf, from, to) {
  const bins = new Map();
  for (const [, , , tally] of index.tallies) {
    for (const [bin, n] of pairsOf(tally)) bins.set(bin, (bins.get(bin) ?? 0) + n);
  }
  const sorted = [...bins].sort(([a], [b]) => a - b);
  const total = sorted.reduce((sum, [, n]) => sum + n, 0);
  if (!total) return null;
  const bin = (part) => {
    let seen = 0;
    for (const [k, n] of sorted) if ((seen += n) >= part * total) return k;
    return sorted.at(-1)[0];
  };
  const edges = index.edges.distances;
  const meters = (k) => edges[Math.min(edges.length - 1, Math.max(0, k))];
  return [meters(bin(from) - 1), meters(bin(to))];
}

/** Depths between which 99 % of all pixels lie: one scale for all frames. */
const depthRange = lengthRange((tally) => tally.distances, 0.005, 0.995) ?? [1, 10];
const depthPart = (meters) =>
  1 - Math.log(Math.min(depthRange[1], Math.max(depthRange[0], meters)) / depthRange[0]) / Math.log(depthRange[1] / depthRange[0]);

/** 256 colors of the depth scale, as one number each. */
const DEPTH_TABLE = Uint32Array.from({ length: 256 }, (_, i) => packed(viridis(i / 255)));
function packed([r, g, b]) { return (255 << 24 | b << 16 | g << 8 | r) >>> 0; }

/** Per-code colors of a depth layer: a lookup in place of a logarithm a pixel. */
function stepColors(layer) {
  if (layer.colors) return layer.colors;
  const colors = new Uint32Array(layer.top + 1).fill(0xffffffff);
  const ratio = Math.log(layer.far / layer.near);
  for (let code = 1; code < layer.top; code++) {
    const part = (code - 1) / (layer.top - 2);
    const meters = layer.even ? layer.near + part * (layer.far - layer.near) : layer.near * Math.exp(part * ratio);
    colors[code] = DEPTH_TABLE[Math.round(255 * depthPart(meters))];
  }
  colors[layer.top] = packed([255, 0, 255]);
  return (layer.colors = colors);
}

/** Colors of the pixels of a stored layer, as a function of the pixel's place. */
function painter(layer, pass) {
  if (layer.code === "halves" || layer.code === "whole" || isOcclusion(pass)) return motionPainter(layer, pass);
  if (layer.code === "ids") {
    const level = levelOf(pass);
    const colors = Uint32Array.from(layer.ids, (id) =>
      packed(level ? level.byId.get(id)?.color ?? [0, 0, 0] : instanceColor(id)));
    return (i) => colors[layer.places[i]];
  }
  if (layer.code === "steps") {
    const colors = stepColors(layer);
    return (i) => colors[layer.codes[i]];
  }
  return (i) => {
    const n = layer.at(i);
    return n ? packed(n.map((v) => Math.round(127.5 * (v + 1)))) : 0xffffffff;
  };
}

/**
 * Draws a pass of a frame onto a canvas of at most the stored size; nearest, but for the picture.
 * Pixels outside of the highlighted class are dimmed.
 */
async function paint(canvas, number, pass, limit, current = () => true) {
  const head = headOf(number);
  const lit = state.highlight;
  const [layer, mask] = await Promise.all([
    layerOf(number, pass), lit ? layerOf(number, `label.${lit.level}`) : null]);
  if (!current()) return;
  const [w, h] = head.stored;
  const factor = Math.min(1, limit / w);
  const width = Math.max(1, Math.round(w * factor));
  const height = Math.max(1, Math.round(h * factor));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  if (!layer) return context.clearRect(0, 0, width, height);
  const columnOf = Int32Array.from({ length: width }, (_, x) => taken(x, width, w));
  const place = (x, y) => taken(y, height, h) * w + columnOf[x];
  if (layer.code === "jpeg") {
    context.imageSmoothingQuality = "high";
    context.drawImage(layer.image, 0, 0, width, height);
  } else {
    const image = context.createImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer);
    const colorOf = painter(layer, pass);
    for (let y = 0, i = 0; y < height; y++) {
      const row = taken(y, height, h) * w;
      for (let x = 0; x < width; x++, i++) pixels[i] = colorOf(row + columnOf[x]);
    }
    context.putImageData(image, 0, 0);
  }
  if (mask) dim(context, width, height, mask, lit.id, place);
}

/** Veils what is not of a class; drawn as a picture of its own, so that nothing is read back. */
function dim(context, width, height, mask, id, place) {
  const veil = new OffscreenCanvas(width, height);
  const image = new ImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0; x < width; x++, i++) {
      pixels[i] = mask.ids[mask.places[place(x, y)]] === id ? 0 : 0xd9201c18;
    }
  }
  veil.getContext("2d").putImageData(image, 0, 0);
  context.drawImage(veil, 0, 0);
}
