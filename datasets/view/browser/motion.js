// Flow, scene flow, disparity, occlusion and raw numbers: colors as scenec.datasets.motion_colors has them.

/** Unit of each pass that has a scale of its own. */
const MOTION = { flow: "px", flow_backward: "px", disparity: "px", scene_flow: "m" };
const isFlow = (pass) => pass === "flow" || pass === "flow_backward";
const isOcclusion = (pass) => pass === "occlusion" || pass === "occlusion_backward" || pass === "disparity_occlusion";
const OCCLUSION = [["visible in the other picture", [222, 226, 230]], ["something stands before it", [204, 68, 51]],
  ["outside of the other picture", [68, 119, 170]], ["nothing to compare with", [119, 119, 119]]];
const NONE = packed([0, 0, 0]);

/** What 99 % of the pixels of all frames are within; of pixels no farther than from corner to corner. */
const widest = Math.ceil(highest(frames.map((frame) => Math.hypot(...frame.size)), 1));
const motionScale = Object.fromEntries(Object.entries(MOTION).map(([pass, unit]) => {
  const within = (lengthRange((tally) => tally.motion[pass] ?? [], 0, 0.99) ?? [0, 1])[1];
  return [pass, unit === "px" ? Math.min(within, widest) : within];
}));

/** The 55 colors of the Middlebury wheel, 0 to 1. */
const WHEEL = (() => {
  const corner = { R: [1, 0, 0], Y: [1, 1, 0], G: [0, 1, 0], C: [0, 1, 1], B: [0, 0, 1], M: [1, 0, 1] };
  return Object.entries({ RY: 15, YG: 6, GC: 4, CB: 11, BM: 13, MR: 6 }).flatMap(([[a, b], n]) =>
    Array.from({ length: n }, (_, i) => corner[a].map((v, k) => {
      const step = Math.floor((255 * i) / n);
      return (v < corner[b][k] ? step : v > corner[b][k] ? 255 - step : 255 * v) / 255;
    })));
})();

function flowColor(u, v) {
  const far = Math.hypot(u, v);
  const at = ((Math.atan2(-v, -u) / Math.PI + 1) / 2) * (WHEEL.length - 1);
  const low = Math.floor(at);
  return WHEEL[low].map((c, k) => {
    const hue = c + (at - low) * (WHEEL[(low + 1) % WHEEL.length][k] - c);
    return Math.floor(255 * (far <= 1 ? 1 - far * (1 - hue) : 0.75 * hue));
  });
}

function motionPainter(layer, pass) {
  if (layer.code === "ids") {
    const colors = Uint32Array.from(layer.ids, (code) => packed(OCCLUSION[code]?.[1] ?? [0, 0, 0]));
    return (i) => colors[layer.places[i]];
  }
  if (layer.code === "whole") {
    // Numbers are linear in light: shown as a picture would be.
    const gray = (code) => Math.round(255 * (code / Math.max(1, layer.top)) ** (1 / 2.2));
    return (i) => { const g = gray(layer.codes[i]); return packed([g, g, g]); };
  }
  const scale = motionScale[pass];
  return (i) => {
    const found = layer.at(i);
    if (!found) return NONE;
    if (isFlow(pass)) return packed(flowColor(found[0] / scale, found[1] / scale));
    if (pass === "scene_flow") return packed(found.map((v) => Math.round(128 + 127 * Math.min(1, Math.max(-1, v / scale)))));
    return packed(viridis(Math.abs(found[0]) / scale));
  };
}

/** What is under the pointer: [name, text, color or null] a line. */
function motionLines(layers, place) {
  const lines = [];
  for (const [pass, unit] of Object.entries(MOTION)) {
    if (!layers[pass]) continue;
    const found = layers[pass].at(place);
    const text = found ? `${found.map((v) => brief(v, 4)).join(", ")} ${unit}` : "not a number";
    lines.push([passTitle(pass).toLowerCase(), found && isFlow(pass) ? `${text}, ${brief(Math.hypot(...found), 4)} long` : text, null]);
  }
  for (const [pass, layer] of Object.entries(layers)) {
    if (!layer || !isOcclusion(pass)) continue;
    const code = layer.ids[layer.places[place]];
    lines.push([passTitle(pass).toLowerCase(), `${OCCLUSION[code]?.[0] ?? "unknown"} (${code})`, OCCLUSION[code]?.[1] ?? [0, 0, 0]]);
  }
  if (layers.raw) lines.push(["raw", count(layers.raw.at(place)), null]);
  return lines;
}

/** Legends of those that any frame has. */
function motionPanels() {
  const panels = [];
  for (const [pass, unit] of Object.entries(MOTION)) {
    if (!allPasses.includes(pass)) continue;
    const scale = `${brief(motionScale[pass], 2)} ${unit}`;
    const panel = make("section.motion", { "data-motion": pass, "data-scale": motionScale[pass] }, make("h3", {}, `${passTitle(pass)}, ${unit}`));
    if (isFlow(pass)) {
      panel.append(make("div.wheel", {}, wheel(), make("p.hint", {}, `where to; ${scale} at the rim, farther is darker; black: not a number`)));
    } else if (pass === "scene_flow") {
      panel.append(make("p.hint", {}, `red x right, green y down, blue z ahead; gray: none, full: ${scale} and more; black: not a number`));
    } else {
      const bar = make("div.scale");
      bar.style.background = `linear-gradient(90deg, ${Array.from({ length: 9 }, (_, i) => css(viridis(i / 8))).join(",")})`;
      panel.append(bar, make("div.ticks", {}, ...["0", brief(motionScale[pass] / 2, 2), scale].map((text) => make("span", {}, text))),
        make("p.hint", {}, "whatever its sign; black: not a number"));
    }
    panels.push(panel);
  }
  if (allPasses.some(isOcclusion)) {
    panels.push(make("section", { "data-motion": "occlusion" }, make("h3", {}, "Occlusion"), ...OCCLUSION.map(([name, color]) =>
      make("div.code", {}, swatch(color), make("span", {}, name)))));
  }
  return panels;
}

function wheel() {
  const side = 64;
  const canvas = make("canvas", { width: side, height: side, role: "img", "aria-label": "Colors of directions" });
  const context = canvas.getContext("2d");
  const image = context.createImageData(side, side);
  const pixels = new Uint32Array(image.data.buffer);
  for (let y = 0, i = 0; y < side; y++) {
    for (let x = 0; x < side; x++, i++) {
      const [u, v] = [((x + 0.5) / side) * 2 - 1, ((y + 0.5) / side) * 2 - 1];
      pixels[i] = Math.hypot(u, v) > 1 ? 0 : packed(flowColor(u, v));
    }
  }
  context.putImageData(image, 0, 0);
  return canvas;
}
