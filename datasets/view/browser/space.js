// A batch in three dimensions: ground, instances, cameras over their samples, suns.

const SPACE_MODES = () => [["drawn", "as drawn"], ...levels.map(({ name }) => [`label.${name}`, `label ${name}`]), ["instance", "instances"]];
const space = { batch: 0, mode: "drawn", sample: 0, loaded: null, three: null, shown: { cameras: true, suns: true } };

const linearOf = Float32Array.from({ length: 256 }, (_, v) => (v <= 10 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4));
const TYPES = { f4: Float32Array, u4: Uint32Array, u2: Uint16Array, i2: Int16Array, u1: Uint8Array, i1: Int8Array };
const batchesInSpace = () => index.batches.map((_, i) => i).filter((i) => $(`m${i}`));

/** The stored facts, with each array as a view of what was inflated. */
async function loadSpace(batch) {
  const text = $(`m${batch}`).content.textContent;
  const end = text.indexOf("\n");
  const raw = await inflate(bytesOf(text.slice(end + 1)));
  const facts = JSON.parse(text.slice(0, end));
  const values = ([kind, at, count]) => new TYPES[kind](raw.buffer, at, count);
  for (const part of facts.parts) {
    for (const name of ["points", "faces", "colors"]) if (part[name]) part[name] = values(part[name]);
    for (const [level, ids] of Object.entries(part.labels)) if (Array.isArray(ids)) part.labels[level] = values(ids);
  }
  for (const place of facts.placements) for (const name of ["positions", "linear", "ids", "variation"]) place[name] = values(place[name]);
  for (const camera of facts.cameras) camera.poses = values(camera.poses);
  return facts;
}

/** Renderer, camera and orbit; null where the browser has no WebGL. */
function openSpace() {
  const canvas = $("space-canvas");
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
  } catch {
    return null;
  }
  renderer.outputEncoding = THREE.sRGBEncoding;
  const camera = new THREE.PerspectiveCamera(50, 1, 0.05, 1e5);
  camera.up.set(0, 0, 1);
  const three = { renderer, camera, orbit: { target: new THREE.Vector3(), yaw: -0.8, pitch: 0.5, away: 50 }, waiting: false };
  const { orbit } = three;
  const dragged = new Map();
  let gap = 0;
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    dragged.set(event.pointerId, event);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => { dragged.delete(event.pointerId); gap = 0; });
  canvas.addEventListener("pointermove", (event) => {
    const before = dragged.get(event.pointerId);
    if (!before) return;
    dragged.set(event.pointerId, event);
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    if (dragged.size === 2) {
      const [a, b] = [...dragged.values()];
      const now = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
      if (gap) orbit.away *= gap / now;
      gap = now;
      pan(dx / 2, dy / 2);
    } else if (event.buttons & 6 || event.shiftKey) pan(dx, dy);
    else turn(dx, dy);
    drawSpace();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    orbit.away = Math.min(1e5, Math.max(0.05, orbit.away * Math.exp(0.0012 * event.deltaY)));
    drawSpace();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [30, 0], ArrowRight: [-30, 0], ArrowUp: [0, 30], ArrowDown: [0, -30] }[event.key];
    if (!step) return;
    event.stopPropagation();
    event.preventDefault();
    if (event.shiftKey) pan(...step);
    else turn(...step);
    drawSpace();
  });
  function turn(dx, dy) {
    orbit.yaw -= 0.006 * dx;
    orbit.pitch = Math.min(1.57, Math.max(-1.57, orbit.pitch + 0.006 * dy));
    orbit.through = null;
  }
  function pan(dx, dy) {
    const scale = (2 * orbit.away * Math.tan(0.0087266 * camera.fov)) / canvas.clientHeight;
    const right = new THREE.Vector3().setFromMatrixColumn(camera.matrix, 0);
    const up = new THREE.Vector3().setFromMatrixColumn(camera.matrix, 1);
    orbit.target.addScaledVector(right, -dx * scale).addScaledVector(up, dy * scale);
    orbit.through = null;
  }
  return three;
}

/** Draws at the browser's next chance. */
function drawSpace() {
  const { three } = space;
  if (!three?.scene || three.waiting) return;
  three.waiting = true;
  requestAnimationFrame(() => {
    three.waiting = false;
    const canvas = $("space-canvas");
    const [w, h] = [canvas.parentElement.clientWidth - ($("space-side").offsetWidth || 0), canvas.parentElement.clientHeight];
    if (w < 1 || h < 1) return;
    const { renderer, camera, orbit, scene } = three;
    renderer.setPixelRatio(window.devicePixelRatio || 1);
    renderer.setSize(w, h, false);
    camera.aspect = w / h;
    if (orbit.through) lookThrough(orbit.through, camera, w / h);
    else {
      camera.fov = 50;
      const flat = Math.cos(orbit.pitch) * orbit.away;
      camera.position.set(orbit.target.x + flat * Math.cos(orbit.yaw), orbit.target.y + flat * Math.sin(orbit.yaw), orbit.target.z + orbit.away * Math.sin(orbit.pitch));
      camera.up.set(0, 0, 1);
      camera.lookAt(orbit.target);
      camera.near = Math.max(0.01, 0.002 * orbit.away);
      camera.far = orbit.away + 4 * three.radius;
    }
    camera.updateProjectionMatrix();
    renderer.render(scene, camera);
    canvas.dataset.drawn = `${space.batch} ${space.mode} ${space.sample}`;
    canvas.dataset.triangles = renderer.info.render.triangles;
  });
}

/** A triangle soup with the normals of its smooth surface; colors are filled in by mode. */
function geometryOf(part) {
  const whole = new THREE.BufferGeometry();
  whole.setAttribute("position", new THREE.BufferAttribute(part.points, 3));
  whole.setIndex(new THREE.BufferAttribute(part.faces, 1));
  whole.computeVertexNormals();
  const geometry = whole.toNonIndexed();
  geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(3 * part.faces.length), 3));
  geometry.computeBoundingSphere();
  return geometry;
}

function paintPart(part, geometry, mode, byInstance) {
  const out = geometry.attributes.color.array;
  const level = mode.startsWith("label.") ? levelOf(mode) : null;
  const put = (corner, color) => { for (let k = 0; k < 3; k++) out[3 * corner + k] = linearOf[color[k]]; };
  const of = (id) => level.byId.get(id)?.color ?? [128, 128, 128];
  const plain = mode === "instance" ? (byInstance ? [255, 255, 255] : instanceColor(0)) : part.color;
  for (let corner = 0; corner < part.faces.length; corner++) {
    if (level) {
      const ids = part.labels[level.name];
      put(corner, of(typeof ids === "number" ? ids : ids?.[Math.floor(corner / 3)] ?? 0));
    } else if (mode === "drawn" && part.colors) {
      const v = part.faces[corner];
      put(corner, part.colors.subarray(3 * v, 3 * v + 3));
    } else put(corner, plain);
  }
  geometry.attributes.color.needsUpdate = true;
}

function paintInstances(mesh, place, mode) {
  const color = new THREE.Color();
  for (let i = 0; i < place.count; i++) {
    if (mode === "instance") {
      const [r, g, b] = instanceColor(place.ids[i]);
      color.setRGB(linearOf[r], linearOf[g], linearOf[b]);
    } else color.setScalar(mode === "drawn" ? 1 + (0.3 * place.variation[i]) / 127 : 1);
    mesh.setColorAt(i, color);
  }
  mesh.instanceColor.needsUpdate = true;
}

/** One InstancedMesh a part and placement; those of a prototype share their geometry. */
function buildSpace(facts) {
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0x9fb4c8);
  const material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide });
  const geometries = new Map();
  const meshes = [];
  const matrix = new THREE.Matrix4();
  for (const place of facts.placements) {
    for (const number of place.parts) {
      if (!geometries.has(number)) geometries.set(number, geometryOf(facts.parts[number]));
      const mesh = new THREE.InstancedMesh(geometries.get(number), material, place.count);
      mesh.frustumCulled = false;
      for (let i = 0; i < place.count; i++) {
        const a = Array.from(place.linear.subarray(9 * i, 9 * i + 9), (v) => (v * place.scale) / 32767);
        const p = place.positions.subarray(3 * i, 3 * i + 3);
        matrix.set(a[0], a[1], a[2], p[0], a[3], a[4], a[5], p[1], a[6], a[7], a[8], p[2], 0, 0, 0, 1);
        mesh.setMatrixAt(i, matrix);
      }
      meshes.push({ mesh, place, part: facts.parts[number] });
      scene.add(mesh);
    }
  }
  const sun = new THREE.DirectionalLight(0xffffff, 1);
  const sky = new THREE.HemisphereLight(0xdfe8ff, 0x8a8078, 1);
  scene.add(sun, sky);
  return { scene, meshes, geometries, lights: { sun, sky } };
}

function paintSpace() {
  const { facts, meshes, geometries, lights } = space.loaded;
  const painted = new Set();
  for (const { mesh, place, part } of meshes) {
    const geometry = geometries.get(facts.parts.indexOf(part));
    if (!painted.has(part)) paintPart(part, geometry, space.mode, Boolean(place.owner));
    painted.add(part);
    paintInstances(mesh, place, place.owner ? space.mode : "still");
  }
  const plain = space.mode !== "drawn";
  lights.sun.intensity = plain ? 0.35 : 1.3;
  lights.sky.intensity = plain ? 0.75 : 0.55;
}

function poseOf(camera, sample) {
  const at = Math.min(camera.poses.length / 12 - 1, Math.floor(sample / camera.every));
  return camera.poses.subarray(12 * at, 12 * at + 12);
}

const pointOf = (p, x, y, z) => new THREE.Vector3(p[0] * x + p[1] * y + p[2] * z + p[3], p[4] * x + p[5] * y + p[6] * z + p[7], p[8] * x + p[9] * y + p[10] * z + p[11]);

/** The lines of a camera's frustum at a distance. */
function frustum(camera, sample, reach) {
  const p = poseOf(camera, sample);
  const [fx, fy, cx, cy] = camera.k;
  const [w, h] = camera.size;
  const corners = [[0, 0], [w, 0], [w, h], [0, h]].map(([u, v]) => pointOf(p, ((u - cx) / fx) * reach, ((v - cy) / fy) * reach, reach));
  const eye = pointOf(p, 0, 0, 0);
  return corners.flatMap((corner, i) => [eye, corner, corner, corners[(i + 1) % 4]]);
}

/** Frusta of all samples, faint, that of the shown one strong; tracks; arrows along which suns shine. */
function paintRigs() {
  const { three, loaded: { facts } } = space;
  if (three.rigs) three.scene.remove(three.rigs);
  three.rigs = new THREE.Group();
  const line = (Kind, points, color, opacity) => three.rigs.add(new Kind(new THREE.BufferGeometry().setFromPoints(points),
    new THREE.LineBasicMaterial({ color, transparent: opacity < 1, opacity, depthTest: opacity < 1 })));
  if (space.shown.cameras) facts.cameras.forEach((camera, i) => {
    const color = SERIES[i % SERIES.length];
    const samples = Array.from({ length: camera.poses.length / 12 }, (_, n) => n * camera.every);
    const reach = 0.04 * three.radius;
    line(THREE.LineSegments, samples.flatMap((s) => frustum(camera, s, reach)), color, 0.45);
    line(THREE.Line, samples.map((s) => pointOf(poseOf(camera, s), 0, 0, 0)), color, 0.9);
    line(THREE.LineSegments, frustum(camera, space.sample, 1.5 * reach), "#ffffff", 1);
  });
  const suns = facts.suns[space.sample] ?? [];
  if (space.shown.suns) for (const [x, y, z] of suns) {
    const to = new THREE.Vector3(x, y, z);
    const length = 0.2 * three.radius;
    const start = three.middle.clone().addScaledVector(to, 0.3 * three.radius);
    three.rigs.add(new THREE.ArrowHelper(to.clone().negate(), start, length, 0xffb000, 0.2 * length, 0.1 * length));
  }
  const [x, y, z] = suns[0] ?? [0.4, -0.5, 0.77];
  space.loaded.lights.sun.position.set(x, y, z);
  three.scene.add(three.rigs);
}

/** The picture of a camera fits into the canvas as a whole; K's center and focal lengths are heeded. */
function lookThrough({ camera, sample }, view, aspect) {
  const p = poseOf(camera, sample);
  view.position.copy(pointOf(p, 0, 0, 0));
  view.up.set(-p[1], -p[5], -p[9]);
  view.lookAt(pointOf(p, 0, 0, 1));
  const [w, h] = camera.size;
  const half = Math.max(h / 2, w / 2 / aspect) / camera.k[1];
  view.fov = (360 / Math.PI) * Math.atan(half);
  view.near = 0.02;
  view.far = 10 * space.three.radius;
}

async function showSpace(batch = space.batch) {
  space.three ??= openSpace();
  if (!space.three) {
    $("space-side").replaceChildren(make("p.hint", {}, "This browser has no WebGL: nothing to draw with."));
    return;
  }
  if (space.loaded && space.batch === batch) return drawSpace();
  space.batch = batch;
  const facts = await loadSpace(batch);
  for (const geometry of space.loaded?.geometries.values() ?? []) geometry.dispose();
  const { three } = space;
  space.loaded = { facts, ...buildSpace(facts) };
  three.scene = space.loaded.scene;
  three.rigs = null;
  fitSpace();
  paintSpace();
  paintRigs();
  spaceBar();
  spaceSide();
  drawSpace();
}

function fitSpace() {
  const { three, loaded: { facts, meshes } } = space;
  const box = new THREE.Box3();
  for (const { mesh, place } of meshes) {
    if (!place.owner) {
      mesh.geometry.computeBoundingBox();
      box.union(mesh.geometry.boundingBox);
    }
  }
  const eyes = facts.cameras.flatMap((camera) => Array.from({ length: camera.poses.length / 12 }, (_, n) => pointOf(poseOf(camera, n * camera.every), 0, 0, 0)));
  for (const eye of eyes) box.expandByPoint(eye);
  const sphere = box.getBoundingSphere(new THREE.Sphere());
  three.radius = sphere.radius || 1;
  // Where cameras are, there is most to see.
  const near = eyes.length ? new THREE.Box3().setFromPoints(eyes).getBoundingSphere(new THREE.Sphere()) : sphere;
  three.middle = near.center.clone();
  Object.assign(three.orbit, { target: near.center.clone(), away: Math.min(2.2 * three.radius, Math.max(0.7 * three.radius, 4 * near.radius)), yaw: -0.8, pitch: 0.5, through: null });
}

function spaceBar() {
  const { facts } = space.loaded;
  const samples = highest(facts.cameras.map((c) => (c.poses.length / 12 - 1) * c.every), facts.suns.length - 1);
  const toggle = (name) => make("label", {}, make("input", { type: "checkbox", checked: space.shown[name], "data-show": name,
    onchange: (event) => { space.shown[name] = event.target.checked; paintRigs(); drawSpace(); } }), ` ${name} `);
  const chosen = make("output", {}, String(space.sample));
  $("space-bar").replaceChildren(
    make("label", {}, "Batch ", make("select", { "aria-label": "Batch", onchange: (e) => showSpace(+e.target.value) },
      ...batchesInSpace().map((i) => make("option", { value: i, selected: i === space.batch }, index.batches[i])))),
    make("label", {}, "Colors ", make("select", { "aria-label": "Colors", id: "space-mode",
      onchange: (event) => { space.mode = event.target.value; paintSpace(); drawSpace(); } },
    ...SPACE_MODES().map(([value, text]) => make("option", { value, selected: value === space.mode }, text)))),
    samples > 0 ? make("label", {}, "Sample ", make("input", { type: "range", min: 0, max: samples, value: space.sample, "aria-label": "Sample",
      oninput: (event) => {
        space.sample = +event.target.value;
        chosen.textContent = event.target.value;
        if (space.three.orbit.through) space.three.orbit.through.sample = space.sample;
        paintRigs();
        drawSpace();
      } }), chosen) : "",
    toggle("cameras"), toggle("suns"),
    make("button.chip", { onclick: () => { fitSpace(); drawSpace(); } }, "Fit"),
    make("span.hint", {}, "drag: turn · shift or right drag: move · wheel: nearer, farther"));
}

function spaceSide() {
  const { facts, meshes } = space.loaded;
  const drawn = meshes.reduce((sum, { place, part }) => sum + (place.count * part.faces.length) / 3, 0);
  const owners = new Map();
  for (const place of facts.placements) if (place.owner) owners.set(place.owner, (owners.get(place.owner) ?? 0) + place.count);
  $("space-side").replaceChildren(
    make("h3", {}, "Through a camera"),
    make("div.keys", {}, ...facts.cameras.map((camera, i) => {
      const button = make("button.chip", { "data-camera": camera.name,
        onclick: () => { space.three.orbit.through = { camera, sample: space.sample }; drawSpace(); } }, camera.name);
      button.style.borderColor = SERIES[i % SERIES.length];
      return button;
    })),
    make("h3", {}, "What is drawn"),
    make("p.hint", {}, `${count(drawn)} triangles`),
    ...[...owners].map(([owner, n]) => make("p.hint", {}, `${owner.split("/").pop()}: ${count(n)}`)),
    make("p.hint", {}, `origin at ${facts.origin.map((v) => brief(v)).join(", ")} m`),
    facts.left_out.length ? make("h3", {}, "What is left out") : "",
    ...facts.left_out.map((text) => make("p.hint", {}, text)));
}

function startSpace() {
  const there = typeof THREE !== "undefined" && batchesInSpace().length > 0;
  $("tab-space").hidden = !there;
  if (!there) return;
  space.batch = batchesInSpace()[0];
  on("tab", (name) => { if (name === "space") showSpace(); });
  new ResizeObserver(drawSpace).observe($("space-area"));
}
